#include <algorithm>
#include <bit>
#include <cmath>
#include <map>
#include <numeric>
#include <set>
#include <stdexcept>

#include <yaml-cpp/yaml.h>

#include <iotcloud/drivers/modbus/register_map.h>

namespace iotcloud::drivers::modbus {

namespace {

constexpr int most_bits = 2000, most_words = 125;  // of one request

const std::map<std::string, Table>& tables() {
  static const std::map<std::string, Table> all{
      {"coil", Table::coil}, {"discrete", Table::discrete}, {"input", Table::input}, {"holding", Table::holding}};
  return all;
}

const std::map<std::string, Type>& types() {
  static const std::map<std::string, Type> all{
      {"bool", Type::boolean},  {"uint16", Type::uint16},   {"int16", Type::int16},
      {"uint32", Type::uint32}, {"int32", Type::int32},     {"uint64", Type::uint64},
      {"int64", Type::int64},   {"float32", Type::float32}, {"float64", Type::float64}};
  return all;
}

/// Reads one entry, and tells its line in what it throws.
class Entry {
 public:
  explicit Entry(const YAML::Node& node) : node_(node) {
    if (!node.IsMap()) refuse("it is no {name: ..., address: ...}");
  }
  [[noreturn]] void refuse(const std::string& why) const {
    throw std::invalid_argument("registers, line " + std::to_string(node_.Mark().line + 1) + ": " + why);
  }
  template <typename Value>
  Value get(const std::string& key, const Value& fallback) {
    known_.insert(key);
    const YAML::Node value = node_[key];
    if (!value) return fallback;
    try {
      return value.as<Value>();
    } catch (const YAML::Exception&) {
      refuse("\"" + key + "\" has a value of another kind");
    }
  }
  template <typename Value>
  Value choice(const std::string& key, const std::string& fallback, const std::map<std::string, Value>& choices) {
    const std::string word = get<std::string>(key, fallback);
    const auto found = choices.find(word);
    if (found != choices.end()) return found->second;
    std::string all;
    for (const auto& [name, value] : choices) all += (all.empty() ? "" : ", ") + name;
    refuse("\"" + key + "\" is \"" + word + "\"; it takes one of: " + all);
  }
  bool has(const std::string& key) const { return static_cast<bool>(node_[key]); }
  void finish() const {
    for (const auto& pair : node_) {
      if (!known_.contains(pair.first.as<std::string>()))
        refuse("there is no key \"" + pair.first.as<std::string>() + "\"");
    }
  }

 private:
  const YAML::Node node_;
  std::set<std::string> known_;
};

Register read_register(const YAML::Node& node) {
  constexpr int last_address = 65'535;
  Entry entry(node);
  Register reg;
  reg.name = entry.get<std::string>("name", "");
  if (reg.name.empty()) entry.refuse("it has no name");
  reg.table = entry.choice("table", "holding", tables());
  reg.type = entry.choice("type", reg.is_bit() ? "bool" : "uint16", types());
  if (reg.is_bit() != (reg.type == Type::boolean))
    entry.refuse("\"type\" is bool for tables coil and discrete, and only there");
  if (!entry.has("address")) entry.refuse("\"" + reg.name + "\" has no address");
  reg.address = entry.get("address", 0);
  if (reg.address < 0 || reg.address > last_address - reg.words() + 1) entry.refuse("\"address\" takes 0 to 65535");
  const int order =
      entry.choice("order", "abcd", std::map<std::string, int>{{"abcd", 0}, {"cdab", 1}, {"badc", 2}, {"dcba", 3}});
  reg.swaps_words = (order & 1) != 0;
  reg.swaps_bytes = (order & 2) != 0;
  reg.scale = entry.get("scale", 1.0);
  reg.offset = entry.get("offset", 0.0);
  if (!std::isfinite(reg.scale) || reg.scale == 0 || !std::isfinite(reg.offset))
    entry.refuse("\"scale\" takes a number, and not 0");
  reg.unit = entry.get<std::string>("unit", "");
  reg.writable = entry.get("writable", false);
  if (reg.writable && reg.table != Table::coil && reg.table != Table::holding)
    entry.refuse("only the tables coil and holding can be written");
  reg.min = entry.get("min", reg.min);
  reg.max = entry.get("max", reg.max);
  if (!(reg.min <= reg.max)) entry.refuse("\"min\" is above \"max\"");
  entry.finish();
  return reg;
}

/// Puts the words of a value into the order abcd, or back.
std::vector<std::uint16_t> ordered(const Register& reg, std::span<const std::uint16_t> words) {
  std::vector<std::uint16_t> all(words.begin(), words.end());
  if (reg.swaps_words) std::reverse(all.begin(), all.end());
  if (reg.swaps_bytes) {
    for (std::uint16_t& word : all) word = static_cast<std::uint16_t>(word >> 8 | word << 8);
  }
  return all;
}

template <typename Number>
std::uint64_t raw_of(const Register& reg, double raw) {
  const double rounded = std::nearbyint(raw);
  const auto least = static_cast<double>(std::numeric_limits<Number>::min());
  const auto beyond = std::ldexp(1.0, std::numeric_limits<Number>::digits);
  if (!(rounded >= least && rounded < beyond))
    throw std::invalid_argument("the device has no room for it in \"" + reg.name + "\"");
  return static_cast<std::uint64_t>(static_cast<Number>(rounded));
}

}  // namespace

int Register::words() const {
  switch (type) {
    case Type::uint32:
    case Type::int32:
    case Type::float32:
      return 2;
    case Type::uint64:
    case Type::int64:
    case Type::float64:
      return 4;
    default:
      return 1;
  }
}

std::vector<Register> read_map(const std::string& yaml) {
  std::vector<Register> map;
  try {
    const YAML::Node list = YAML::Load(yaml);
    if (!list.IsSequence())
      throw std::invalid_argument("registers: it takes a list, such as [{name: power, address: 30, type: float32}]");
    std::set<std::string> names;
    for (const YAML::Node& node : list) {
      map.push_back(read_register(node));
      if (!names.insert(map.back().name).second)
        Entry(node).refuse("there are two registers \"" + map.back().name + "\"");
    }
  } catch (const YAML::Exception& e) {
    throw std::invalid_argument("registers, line " + std::to_string(e.mark.line + 1) + ": " + e.msg);
  }
  if (map.empty()) throw std::invalid_argument("registers: the list is empty");
  return map;
}

std::vector<Group> groups_of(const std::vector<Register>& map) {
  std::vector<std::size_t> places(map.size());
  std::iota(places.begin(), places.end(), std::size_t{0});
  std::stable_sort(places.begin(), places.end(), [&](std::size_t a, std::size_t b) {
    return std::pair(map[a].table, map[a].address) < std::pair(map[b].table, map[b].address);
  });
  std::vector<Group> groups;
  for (const std::size_t place : places) {
    const Register& reg = map[place];
    const int end = reg.address + reg.words();
    const int most = reg.is_bit() ? most_bits : most_words;
    const bool neighbour = !groups.empty() && groups.back().table == reg.table &&
                           reg.address <= groups.back().first + groups.back().count &&
                           end - groups.back().first <= most;
    if (!neighbour) groups.push_back({reg.table, reg.address, 0, {}});
    groups.back().count = std::max(groups.back().count, end - groups.back().first);
    groups.back().registers.push_back(place);
  }
  return groups;
}

Value decode(const Register& reg, std::span<const std::uint16_t> words) {
  if (reg.is_bit()) return words.front() != 0;
  std::uint64_t raw = 0;
  for (const std::uint16_t word : ordered(reg, words)) raw = raw << 16 | word;
  const auto scaled = [&](auto number) -> Value {
    if (reg.scale == 1 && reg.offset == 0) {
      if constexpr (std::is_floating_point_v<decltype(number)>)
        return static_cast<double>(number);
      else if constexpr (std::is_signed_v<decltype(number)>)
        return static_cast<std::int64_t>(number);
      else
        return static_cast<std::uint64_t>(number);
    }
    return static_cast<double>(number) * reg.scale + reg.offset;
  };
  switch (reg.type) {
    case Type::int16:
      return scaled(static_cast<std::int16_t>(raw));
    case Type::uint32:
      return scaled(static_cast<std::uint32_t>(raw));
    case Type::int32:
      return scaled(static_cast<std::int32_t>(raw));
    case Type::uint64:
      return scaled(raw);
    case Type::int64:
      return scaled(static_cast<std::int64_t>(raw));
    case Type::float32:
      return scaled(std::bit_cast<float>(static_cast<std::uint32_t>(raw)));
    case Type::float64:
      return scaled(std::bit_cast<double>(raw));
    default:
      return scaled(static_cast<std::uint16_t>(raw));
  }
}

std::vector<std::uint16_t> encode(const Register& reg, double value) {
  if (!(value >= reg.min && value <= reg.max))
    throw std::invalid_argument("it is out of the range that the map gives to \"" + reg.name + "\"");
  const double number = (value - reg.offset) / reg.scale;
  std::uint64_t raw = 0;
  switch (reg.type) {
    case Type::int16:
      raw = raw_of<std::int16_t>(reg, number);
      break;
    case Type::uint32:
      raw = raw_of<std::uint32_t>(reg, number);
      break;
    case Type::int32:
      raw = raw_of<std::int32_t>(reg, number);
      break;
    case Type::uint64:
      raw = raw_of<std::uint64_t>(reg, number);
      break;
    case Type::int64:
      raw = raw_of<std::int64_t>(reg, number);
      break;
    case Type::float32:
      if (std::abs(number) > std::numeric_limits<float>::max())
        throw std::invalid_argument("the device has no room for it in \"" + reg.name + "\"");
      raw = std::bit_cast<std::uint32_t>(static_cast<float>(number));
      break;
    case Type::float64:
      raw = std::bit_cast<std::uint64_t>(number);
      break;
    default:
      raw = raw_of<std::uint16_t>(reg, number);
      break;
  }
  std::vector<std::uint16_t> words;
  for (int i = reg.words() - 1; i >= 0; --i) words.push_back(static_cast<std::uint16_t>(raw >> (16 * i) & 0xffff));
  return ordered(reg, words);
}

}  // namespace iotcloud::drivers::modbus
