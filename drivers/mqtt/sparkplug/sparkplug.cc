#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <limits>
#include <stdexcept>
#include <utility>

#include <payload.pb.h>

#include <iotcloud/drivers/mqtt/sparkplug/sparkplug.h>

namespace iotcloud::drivers::mqtt::sparkplug {

namespace {

constexpr std::string_view namespace_b = "spBv1.0/";
constexpr std::uint64_t numbers = 256;  ///< of messages, from 0

constexpr std::pair<std::string_view, Kind> kinds[] = {{"NBIRTH", Kind::node_birth},   {"NDATA", Kind::node_data},
                                                       {"NDEATH", Kind::node_death},   {"NCMD", Kind::node_command},
                                                       {"DBIRTH", Kind::device_birth}, {"DDATA", Kind::device_data},
                                                       {"DDEATH", Kind::device_death}, {"DCMD", Kind::device_command}};

constexpr std::array type_names{"Unknown", "Int8",   "Int16",   "Int32",  "Int64",   "UInt8",   "UInt16",
                                "UInt32",  "UInt64", "Float",   "Double", "Boolean", "String",  "DateTime",
                                "Text",    "UUID",   "DataSet", "Bytes",  "File",    "Template"};

using Proto = ::iotcloud::sparkplug::Metric;

/// A signed value of so many bits travels as the unsigned one of the same bits.
std::int64_t signed_of(std::uint64_t bits, Type type) {
  switch (type) {
    case Type::int8:
      return static_cast<std::int8_t>(bits);
    case Type::int16:
      return static_cast<std::int16_t>(bits);
    case Type::int32:
      return static_cast<std::int32_t>(bits);
    default:
      return static_cast<std::int64_t>(bits);
  }
}

bool is_signed(Type type) {
  return type >= Type::int8 && type <= Type::int64;
}

Value whole_value(std::uint64_t bits, Type type) {
  if (is_signed(type)) return signed_of(bits, type);
  return bits;
}

Metric metric_of(const Proto& from) {
  Metric metric;
  metric.name = from.name();
  if (from.has_alias()) metric.alias = from.alias();
  if (from.has_timestamp()) metric.timestamp_ms = from.timestamp();
  if (from.has_datatype()) metric.type = static_cast<Type>(from.datatype());
  metric.is_historical = from.is_historical();
  if (from.is_null()) return metric;
  const Type type = metric.type.value_or(Type::unknown);
  switch (from.value_case()) {
    case Proto::kIntValue:
      metric.value = whole_value(from.int_value(), type);
      break;
    case Proto::kLongValue:
      metric.value = whole_value(from.long_value(), type);
      break;
    case Proto::kFloatValue:
      metric.value = from.float_value();
      break;
    case Proto::kDoubleValue:
      metric.value = from.double_value();
      break;
    case Proto::kBooleanValue:
      metric.value = from.boolean_value();
      break;
    case Proto::kStringValue:
      metric.value = from.string_value();
      break;
    case Proto::kBytesValue:
      metric.value = from.bytes_value();
      metric.is_opaque = true;
      break;
    case Proto::kDatasetValue:
      metric.value = from.dataset_value();
      metric.is_opaque = true;
      break;
    case Proto::kTemplateValue:
      metric.value = from.template_value();
      metric.is_opaque = true;
      break;
    case Proto::VALUE_NOT_SET:
      break;
  }
  return metric;
}

bool is_of_32_bits(Type type) {
  return type == Type::int8 || type == Type::int16 || type == Type::int32 || type == Type::uint8 ||
         type == Type::uint16 || type == Type::uint32;
}

void put_whole(Proto& into, std::uint64_t bits, Type type) {
  if (is_of_32_bits(type)) {
    into.set_int_value(static_cast<std::uint32_t>(bits));
  } else {
    into.set_long_value(bits);
  }
}

void put_value(Proto& into, const Metric& metric) {
  const Type type = metric.type.value_or(Type::unknown);
  if (const auto* flag = std::get_if<bool>(&metric.value)) {
    into.set_boolean_value(*flag);
  } else if (const auto* whole = std::get_if<std::int64_t>(&metric.value)) {
    put_whole(into, static_cast<std::uint64_t>(*whole), type);
  } else if (const auto* natural = std::get_if<std::uint64_t>(&metric.value)) {
    put_whole(into, *natural, type);
  } else if (const auto* single = std::get_if<float>(&metric.value)) {
    into.set_float_value(*single);
  } else if (const auto* real = std::get_if<double>(&metric.value)) {
    into.set_double_value(*real);
  } else if (const auto* text = std::get_if<std::string>(&metric.value)) {
    if (type == Type::bytes || type == Type::file) {
      into.set_bytes_value(*text);
    } else {
      into.set_string_value(*text);
    }
  } else {
    into.set_is_null(true);
  }
}

template <typename Number>
Number number_in(const std::string& text, Type type, Number least, Number most) {
  Number number{};
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (status != std::errc{} || end != text.data() + text.size() || !(number >= least && number <= most)) {
    throw std::invalid_argument("\"" + text + "\" is no " + name_of(type) + "; it takes " + std::to_string(least) +
                                " to " + std::to_string(most));
  }
  return number;
}

template <typename Small, typename Number>
Value bounded(const std::string& text, Type type) {
  return number_in<Number>(text, type, std::numeric_limits<Small>::lowest(), std::numeric_limits<Small>::max());
}

const Metric* find_metric(const Payload& payload, std::string_view name) {
  const auto found = std::find_if(payload.metrics.begin(), payload.metrics.end(),
                                  [&](const Metric& metric) { return metric.name == name; });
  return found == payload.metrics.end() ? nullptr : &*found;
}

/// The number of the session that a birth or death certificate is of.
std::optional<std::uint64_t> session_of(const Payload& payload) {
  const Metric* metric = find_metric(payload, "bdSeq");
  if (metric == nullptr) return std::nullopt;
  if (const auto* whole = std::get_if<std::int64_t>(&metric->value)) return static_cast<std::uint64_t>(*whole);
  if (const auto* natural = std::get_if<std::uint64_t>(&metric->value)) return *natural;
  return std::nullopt;
}

}  // namespace

std::string Topic::text() const {
  const auto* found =
      std::find_if(std::begin(kinds), std::end(kinds), [this](const auto& pair) { return pair.second == kind; });
  std::string text = std::string(namespace_b) + group + "/" + std::string(found->first) + "/" + node;
  return device.empty() ? text : text + "/" + device;
}

std::optional<Topic> parse_topic(std::string_view topic) {
  if (!topic.starts_with(namespace_b)) return std::nullopt;
  std::vector<std::string> levels;
  for (std::size_t at = namespace_b.size(); at <= topic.size();) {
    const std::size_t end = std::min(topic.find('/', at), topic.size());
    levels.emplace_back(topic.substr(at, end - at));
    at = end + 1;
    if (levels.back().empty() || levels.size() > 4) return std::nullopt;
  }
  if (levels.size() < 3) return std::nullopt;
  const auto* kind =
      std::find_if(std::begin(kinds), std::end(kinds), [&](const auto& pair) { return pair.first == levels[1]; });
  if (kind == std::end(kinds)) return std::nullopt;
  const bool of_device = kind->first.front() == 'D';
  if (of_device != (levels.size() == 4)) return std::nullopt;
  return Topic{levels[0], levels[2], of_device ? levels[3] : "", kind->second};
}

std::string name_of(Type type) {
  const auto number = static_cast<std::size_t>(type);
  return number < type_names.size() ? type_names[number] : type_names[0];
}

std::optional<Payload> decode(std::string_view bytes) {
  ::iotcloud::sparkplug::Payload from;
  if (bytes.size() > static_cast<std::size_t>(std::numeric_limits<int>::max()) ||
      !from.ParseFromArray(bytes.data(), static_cast<int>(bytes.size())))
    return std::nullopt;
  if (static_cast<std::size_t>(from.metrics_size()) > most_metrics) return std::nullopt;
  Payload payload;
  if (from.has_timestamp()) payload.timestamp_ms = from.timestamp();
  if (from.has_seq()) payload.seq = from.seq();
  payload.metrics.reserve(static_cast<std::size_t>(from.metrics_size()));
  for (const auto& metric : from.metrics()) payload.metrics.push_back(metric_of(metric));
  return payload;
}

std::string encode(const Payload& payload) {
  ::iotcloud::sparkplug::Payload into;
  if (payload.timestamp_ms) into.set_timestamp(*payload.timestamp_ms);
  if (payload.seq) into.set_seq(*payload.seq);
  for (const Metric& metric : payload.metrics) {
    auto& one = *into.add_metrics();
    if (!metric.name.empty()) one.set_name(metric.name);
    if (metric.alias) one.set_alias(*metric.alias);
    if (metric.timestamp_ms) one.set_timestamp(*metric.timestamp_ms);
    if (metric.type) one.set_datatype(static_cast<std::uint32_t>(*metric.type));
    if (metric.is_historical) one.set_is_historical(true);
    put_value(one, metric);
  }
  return into.SerializeAsString();
}

Value value_of(Type type, const std::string& text) {
  switch (type) {
    case Type::int8:
      return bounded<std::int8_t, std::int64_t>(text, type);
    case Type::int16:
      return bounded<std::int16_t, std::int64_t>(text, type);
    case Type::int32:
      return bounded<std::int32_t, std::int64_t>(text, type);
    case Type::int64:
      return bounded<std::int64_t, std::int64_t>(text, type);
    case Type::uint8:
      return bounded<std::uint8_t, std::uint64_t>(text, type);
    case Type::uint16:
      return bounded<std::uint16_t, std::uint64_t>(text, type);
    case Type::uint32:
      return bounded<std::uint32_t, std::uint64_t>(text, type);
    case Type::uint64:
    case Type::date_time:
      return bounded<std::uint64_t, std::uint64_t>(text, type);
    case Type::floating:
      return number_in<float>(text, type, std::numeric_limits<float>::lowest(), std::numeric_limits<float>::max());
    case Type::real:
      return number_in<double>(text, type, std::numeric_limits<double>::lowest(), std::numeric_limits<double>::max());
    case Type::boolean:
      if (text != "true" && text != "false")
        throw std::invalid_argument("\"" + text + "\" is no Boolean; it takes true or false");
      return text == "true";
    case Type::string:
    case Type::text:
    case Type::uuid:
    case Type::bytes:
    case Type::file:
      return text;
    default:
      throw std::invalid_argument("metrics of the type " + name_of(type) + " cannot be written");
  }
}

std::uint64_t wall_time_ms() {
  const auto since = std::chrono::system_clock::now().time_since_epoch();
  return static_cast<std::uint64_t>(std::chrono::duration_cast<std::chrono::milliseconds>(since).count());
}

Payload rebirth_request(std::uint64_t now_ms) {
  Metric metric;
  metric.name = "Node Control/Rebirth";
  metric.type = Type::boolean;
  metric.timestamp_ms = now_ms;
  metric.value = true;
  Payload payload;
  payload.timestamp_ms = now_ms;
  payload.metrics.push_back(std::move(metric));
  return payload;
}

Node::Heard Node::take(const Topic& topic, Payload& payload) {
  switch (topic.kind) {
    case Kind::node_death: {
      // A death certificate is the broker's last will: that of an earlier session may come late.
      const auto session = session_of(payload);
      if (alive_ && session_ && session && *session != *session_) return Heard::stale;
      alive_ = false;
      expected_.reset();
      forget_all();
      return Heard::in_order;
    }
    case Kind::node_birth:
      session_ = session_of(payload);
      forget_all();
      expected_ = payload.seq ? std::optional((*payload.seq + 1) % numbers) : std::nullopt;
      alive_ = learn("", payload);
      return alive_ ? Heard::in_order : Heard::too_much;
    case Kind::node_command:
    case Kind::device_command:
      return Heard::stale;
    default:
      break;
  }
  const bool follows = alive_ && expected_ && payload.seq && *payload.seq == *expected_;
  if (payload.seq && alive_) expected_ = (*payload.seq + 1) % numbers;
  if (topic.kind == Kind::device_birth) {
    if (!learn(topic.device, payload)) return Heard::too_much;
  } else if (topic.kind == Kind::device_death) {
    forget(topic.device);
  } else if (!complete(topic.device, payload)) {
    return Heard::gap;
  }
  return follows ? Heard::in_order : Heard::gap;
}

void Node::forget(const std::string& device) {
  const auto known = metrics_.find(device);
  if (known == metrics_.end()) return;
  bytes_ -= known->second.bytes;
  metrics_.erase(known);
}

void Node::forget_all() {
  metrics_.clear();
  bytes_ = 0;
}

/// \return false: that would be too much, and the device is not known any more
bool Node::learn(const std::string& device, const Payload& payload) {
  constexpr std::size_t overhead = 128;  // of an entry, about
  forget(device);
  Known known;
  known.bytes = overhead + device.size();
  for (const Metric& metric : payload.metrics) {
    if (metric.name.empty()) continue;
    known.types[metric.name] = metric.type.value_or(Type::unknown);
    if (metric.alias) known.names[*metric.alias] = metric.name;
    known.bytes += 2 * (overhead + metric.name.size());
  }
  if (bytes_ + known.bytes > most_bytes) return false;
  bytes_ += known.bytes;
  metrics_.emplace(device, std::move(known));
  return true;
}

/// \return false: a metric is not known by its birth certificate
bool Node::complete(const std::string& device, Payload& payload) const {
  const auto known = metrics_.find(device);
  if (known == metrics_.end()) return false;
  bool all = true;
  for (Metric& metric : payload.metrics) {
    if (metric.name.empty() && metric.alias) {
      const auto name = known->second.names.find(*metric.alias);
      if (name != known->second.names.end()) metric.name = name->second;
    }
    const auto type = known->second.types.find(metric.name);
    if (metric.name.empty() || type == known->second.types.end()) {
      all = false;
      continue;
    }
    if (metric.type) continue;
    metric.type = type->second;
    const auto* bits = std::get_if<std::uint64_t>(&metric.value);
    if (bits != nullptr) metric.value = whole_value(*bits, type->second);
  }
  return all;
}

std::optional<Type> Node::type_of(const std::string& device, const std::string& metric) const {
  const auto known = metrics_.find(device);
  if (known == metrics_.end()) return std::nullopt;
  const auto type = known->second.types.find(metric);
  return type == known->second.types.end() ? std::nullopt : std::optional(type->second);
}

}  // namespace iotcloud::drivers::mqtt::sparkplug
