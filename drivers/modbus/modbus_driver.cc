#include <algorithm>
#include <cerrno>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <utility>

#include <modbus/modbus.h>
#include <nlohmann/json.hpp>

#include <iotcloud/drivers/modbus/modbus_driver.h>
#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::drivers::modbus {

namespace {

/// Whether it is an answer of the device: it refuses the request. A gateway answers in place of a device that does not
/// (EMBXGPATH, EMBXGTAR).
bool is_refusal(int error) {
  return error >= EMBXILFUN && error <= EMBXGTAR && error != EMBXGPATH && error != EMBXGTAR;
}

/// Whether noise may be the cause, so that another try may succeed.
bool may_be_noise(int error) {
  return error == EMBBADCRC || error == EMBBADDATA || error == ETIMEDOUT;
}

nlohmann::json in_json(const Value& value) {
  return std::visit([](auto number) { return nlohmann::json(number); }, value);
}

std::string text_of(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw std::invalid_argument("property \"registers_file\": \"" + file + "\" cannot be read");
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

ModbusDriver::~ModbusDriver() {
  disconnect();
}

ModbusDriver::Options ModbusDriver::read_options(const PropertyMap& properties) {
  PropertyReader reader(properties);
  Options options;
  const std::string connect = reader.text("connect", "");
  options.device = reader.text("device", "");
  if (connect.empty() == options.device.empty()) {
    throw std::invalid_argument(
        "give one of the properties \"connect\" (HOST[:502], Modbus TCP) and \"device\" (a serial line, Modbus RTU)");
  }
  const auto colon = connect.find(']') == std::string::npos ? connect.rfind(':') : connect.find(':', connect.find(']'));
  options.host = connect.substr(0, colon);
  options.port = colon == std::string::npos ? "502" : connect.substr(colon + 1);
  if (options.host.size() > 2 && options.host.front() == '[')
    options.host = options.host.substr(1, options.host.size() - 2);
  options.baud = static_cast<int>(reader.integer("baud", 19'200, 300, 4'000'000));
  const std::string parity = reader.choice("parity", "even", {"none", "even", "odd"});
  options.parity = parity == "none" ? 'N' : parity == "odd" ? 'O' : 'E';
  options.stop_bits = std::stoi(reader.choice("stop_bits", "1", {"1", "2"}));
  options.unit = static_cast<int>(reader.integer("unit", 1, 0, 255));
  if (!options.device.empty() && options.unit > 247)
    throw std::invalid_argument("property \"unit\" takes 0 to 247 on a serial line");
  const auto duration = [&](const std::string& name, int fallback, int min, int max) {
    return std::chrono::milliseconds(reader.integer(name, fallback, min, max));
  };
  options.period = duration("period_ms", 1000, 10, 86'400'000);
  options.timeout = duration("timeout_ms", 500, 10, 5'000);
  options.pauses = stream::ReconnectPauses::read(reader);
  options.only_changes = reader.choice("report", "all", {"all", "changes"}) == "changes";
  options.broker = reader.text("broker", "");
  const std::string map = reader.text("registers", ""), file = reader.text("registers_file", "");
  if (map.empty() == file.empty())
    throw std::invalid_argument("give one of the properties \"registers\" (the map, in YAML) and \"registers_file\"");
  options.map = read_map(map.empty() ? text_of(file) : map);
  return options;
}

std::vector<ChannelSpec> ModbusDriver::channels(const PropertyMap& properties) {
  options_ = read_options(properties);
  ChannelSpec readings;
  readings.name = readings_channel;
  readings.broker = options_.broker;
  ChannelSpec commands = readings;
  commands.name = write_channel;
  commands.direction = Direction::in;
  return {readings, commands};
}

void ModbusDriver::open(DriverContext& context) {
  context_ = &context;
  groups_ = groups_of(options_.map);
  lost_.emplace(context);
  retry_.emplace(context, options_.pauses);
  state_.emplace(context);
  std::string units;
  for (const Register& reg : options_.map) {
    if (!reg.unit.empty()) units += (units.empty() ? "" : ", ") + reg.name + "=" + reg.unit;
  }
  if (!units.empty()) context.update_metadata({{"units", units}});
  connect();
}

void ModbusDriver::connect() {
  const bool tcp = options_.device.empty();
  device_ = tcp ? modbus_new_tcp_pi(options_.host.c_str(), options_.port.c_str())
                : modbus_new_rtu(options_.device.c_str(), options_.baud, options_.parity, 8, options_.stop_bits);
  const std::string whom = tcp ? options_.host + ":" + options_.port : options_.device;
  if (!device_) throw std::invalid_argument(whom + ": " + modbus_strerror(errno));
  const auto us = std::chrono::microseconds(options_.timeout).count();
  modbus_set_response_timeout(device_, static_cast<std::uint32_t>(us / 1'000'000),
                              static_cast<std::uint32_t>(us % 1'000'000));
  if (modbus_set_slave(device_, options_.unit) != 0 || modbus_connect(device_) != 0)
    return away("cannot connect to " + whom + ": " + modbus_strerror(errno));
  // A connection says nothing of the device behind it: that is there when it answers.
  if (const std::string problem = read(groups_.front()); !problem.empty()) return away(whom + ": " + problem);
  retry_->reached();
  state_->connected({{"modbus", whom + " unit " + std::to_string(options_.unit)}});
}

void ModbusDriver::disconnect() {
  if (!device_) return;
  modbus_close(device_);
  modbus_free(std::exchange(device_, nullptr));
}

void ModbusDriver::away(const std::string& reason) {
  disconnect();
  state_->away(reason);
  retry_->later([this] { connect(); });
}

void ModbusDriver::activate() {
  timer_ = context_->every(options_.period, [this] { poll(); });
}

void ModbusDriver::deactivate() {
  if (timer_) context_->stop(*std::exchange(timer_, std::nullopt));
}

void ModbusDriver::close() {
  deactivate();
  retry_.reset();
  disconnect();
}

void ModbusDriver::poll() {
  if (!state_->is_there() || unpublished_) return;
  values_.clear();
  for (const Group& group : groups_) {
    if (const std::string problem = read(group); !problem.empty()) return away(problem);
  }
  nlohmann::ordered_json all;
  for (std::size_t i = 0; i < options_.map.size(); ++i) {
    const auto value = values_.find(i);
    all[options_.map[i].name] = value == values_.end() ? nlohmann::json() : in_json(value->second);
  }
  publish(all.dump());
}

void ModbusDriver::publish(const std::string& json) {
  if (options_.only_changes && json == last_) return;
  if (context_->publish(readings_channel, Payload::copy(json)) == PublishStatus::would_block) {
    unpublished_ = json;
    return;
  }
  last_ = json;
}

void ModbusDriver::on_writable(std::string_view channel) {
  if (channel == readings_channel && unpublished_) publish(*std::exchange(unpublished_, std::nullopt));
}

int ModbusDriver::request(Table table, int first, int count) {
  words_.assign(static_cast<std::size_t>(count), 0);
  std::vector<std::uint8_t> bits(words_.size());
  const int tries = options_.device.empty() ? 1 : 2;
  for (int i = 1;; ++i) {
    int done = 0;
    switch (table) {
      case Table::coil:
        done = modbus_read_bits(device_, first, count, bits.data());
        break;
      case Table::discrete:
        done = modbus_read_input_bits(device_, first, count, bits.data());
        break;
      case Table::input:
        done = modbus_read_input_registers(device_, first, count, words_.data());
        break;
      case Table::holding:
        done = modbus_read_registers(device_, first, count, words_.data());
        break;
    }
    if (done == count) break;
    const int error = errno;
    if (i >= tries || !may_be_noise(error)) return error;
    modbus_flush(device_);
  }
  if (table == Table::coil || table == Table::discrete) words_.assign(bits.begin(), bits.end());
  return 0;
}

std::string ModbusDriver::read(const Group& group) {
  const int error = request(group.table, group.first, group.count);
  if (error != 0 && !is_refusal(error)) return modbus_strerror(error);
  if (error != 0 && group.registers.size() > 1) {
    for (const std::size_t place : group.registers) {
      const Register& reg = options_.map[place];
      std::string problem = read(Group{reg.table, reg.address, reg.words(), {place}});
      if (!problem.empty()) return problem;
    }
    return "";
  }
  for (const std::size_t place : group.registers) {
    const Register& reg = options_.map[place];
    if (error != 0) {
      if (refused_.insert(place).second)
        context_->log(LogLevel::warn,
                      "the device refuses to read \"" + reg.name + "\", which is null: " + modbus_strerror(error));
      continue;
    }
    refused_.erase(place);
    const auto first = static_cast<std::size_t>(reg.address - group.first);
    values_[place] = decode(reg, std::span(words_).subspan(first, static_cast<std::size_t>(reg.words())));
  }
  return "";
}

void ModbusDriver::on_message(std::string_view channel, Message message) {
  if (channel != write_channel) return;
  if (const std::string problem = write(std::string(message.payload.text())); !problem.empty())
    lost_->warn("a command is lost: " + problem);
}

std::string ModbusDriver::write(const std::string& json) {
  // Nothing in it is deeper than a value: whatever is would be copied and destroyed recursively.
  const auto is_flat = [](int depth, nlohmann::json::parse_event_t, const nlohmann::json&) { return depth < 2; };
  const auto values = nlohmann::json::parse(json, is_flat, false);
  if (!values.is_object()) return "it is no JSON object such as {\"setpoint\": 21.5}";
  std::vector<std::pair<const Register*, double>> writes;
  for (const auto& [name, value] : values.items()) {
    const auto reg = std::find_if(options_.map.begin(), options_.map.end(),
                                  [&, key = name](const Register& r) { return r.name == key; });
    if (reg == options_.map.end() || !reg->writable) return "the map has no writable register \"" + name + "\"";
    if (reg->is_bit() ? !value.is_boolean() : !value.is_number())
      return "\"" + name + "\" takes " + (reg->is_bit() ? "true or false" : "a number");
    writes.emplace_back(&*reg, value.is_boolean() ? static_cast<double>(value.get<bool>()) : value.get<double>());
    try {
      if (!reg->is_bit()) encode(*reg, writes.back().second);
    } catch (const std::invalid_argument& e) {
      return value.dump() + ": " + e.what();
    }
  }
  if (!state_->is_there()) return "the device is away";
  for (const auto& [reg, value] : writes) {
    if (std::string problem = write(*reg, value); !problem.empty()) return problem;
  }
  return "";
}

std::string ModbusDriver::write(const Register& reg, double value) {
  int done = 0;
  if (reg.is_bit()) {
    done = modbus_write_bit(device_, reg.address, value != 0 ? 1 : 0);
  } else {
    const std::vector<std::uint16_t> words = encode(reg, value);
    done = words.size() == 1
               ? modbus_write_register(device_, reg.address, words.front())
               : modbus_write_registers(device_, reg.address, static_cast<int>(words.size()), words.data());
  }
  if (done > 0) return "";
  const int error = errno;
  const std::string why = modbus_strerror(error);
  if (!is_refusal(error)) away(why);
  return "the device does not take \"" + reg.name + "\": " + why;
}

}  // namespace iotcloud::drivers::modbus
