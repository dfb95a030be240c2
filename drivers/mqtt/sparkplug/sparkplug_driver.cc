#include <cmath>
#include <stdexcept>
#include <utility>
#include <variant>

#include <mosquitto.h>
#include <nlohmann/json.hpp>

#include <iotcloud/drivers/mqtt/sparkplug/sparkplug_driver.h>

namespace iotcloud::drivers::mqtt::sparkplug {

using nlohmann::json;

namespace {

/// Time until a node is asked for its birth certificates once more.
constexpr std::chrono::seconds asking_pause{10};

std::string hex(const std::string& bytes) {
  constexpr std::string_view digits = "0123456789abcdef";
  std::string text;
  for (const char c : bytes) {
    const auto byte = static_cast<unsigned char>(c);
    text += digits[byte >> 4];
    text += digits[byte & 0xf];
  }
  return text;
}

json value_json(const Metric& metric) {
  return std::visit(
      [&](const auto& value) -> json {
        using Is = std::remove_cvref_t<decltype(value)>;
        if constexpr (std::is_same_v<Is, std::monostate>) {
          return nullptr;
        } else if constexpr (std::is_same_v<Is, std::string>) {
          return metric.is_opaque ? hex(value) : value;
        } else {
          return value;
        }
      },
      metric.value);
}

std::string kind_name(Kind kind) {
  switch (kind) {
    case Kind::node_birth:
    case Kind::device_birth:
      return "birth";
    case Kind::node_death:
    case Kind::device_death:
      return "death";
    default:
      return "data";
  }
}

void check_level(const char* property, const std::string& text) {
  if (text.find_first_of("/+#") == std::string::npos) return;
  throw std::invalid_argument(std::string("property \"") + property + "\" is \"" + text +
                              "\"; it takes a name without \"/\", \"+\" and \"#\"");
}

}  // namespace

std::string json_of(const Topic& topic, const Payload& payload) {
  json metrics = json::array();
  for (const Metric& metric : payload.metrics) {
    if (metric.name.empty()) continue;
    json one{{"name", metric.name}, {"value", value_json(metric)}};
    if (metric.type) one["type"] = name_of(*metric.type);
    if (metric.timestamp_ms) one["timestamp"] = *metric.timestamp_ms;
    if (metric.is_historical) one["historical"] = true;
    metrics.push_back(std::move(one));
  }
  json body{
      {"kind", kind_name(topic.kind)}, {"group", topic.group}, {"node", topic.node}, {"metrics", std::move(metrics)}};
  if (!topic.device.empty()) body["device"] = topic.device;
  if (payload.timestamp_ms) body["timestamp"] = *payload.timestamp_ms;
  return body.dump(-1, ' ', false, json::error_handler_t::replace);
}

SparkplugDriver::Options SparkplugDriver::read_options(const PropertyMap& properties) {
  PropertyReader reader(properties);
  Options options;
  options.client = ClientOptions::read(reader);
  options.group = reader.text("group", "");
  options.node = reader.text("node", "");
  options.device = reader.text("device", "");
  options.broker = reader.text("broker", "");
  check_level("group", options.group);
  check_level("node", options.node);
  check_level("device", options.device);
  return options;
}

std::vector<ChannelSpec> SparkplugDriver::channels(const PropertyMap& properties) {
  options_ = read_options(properties);
  ChannelSpec metrics;
  metrics.name = metrics_channel;
  metrics.broker = options_.broker;
  ChannelSpec commands;
  commands.name = commands_channel;
  commands.direction = Direction::in;
  commands.broker = options_.broker;
  return {metrics, commands};
}

void SparkplugDriver::open(DriverContext& context) {
  context_ = &context;
  lost_.emplace(context);
  refused_.emplace(context);
  Client::Events events;
  events.on_connected = [this] { connected(); };
  events.on_message = [this](const auto& message, const auto*) {
    received(message.topic, {static_cast<const char*>(message.payload), static_cast<std::size_t>(message.payloadlen)});
  };
  events.on_away = [this](const std::string&) { known_.lose_track(); };
  events.after_step = [this] { drain(); };
  events.may_read = [this] { return pending_.empty(); };
  client_.emplace(context, options_.client, std::move(events));
  context.update_metadata({{"alive", "false"}});
  context.every(asking_pause, [this] { asked_ = false; });
  client_->connect();
}

/// A node numbers its own messages and those of its devices together, so the node's instance hears the devices, too.
void SparkplugDriver::connected() {
  const std::string group = "spBv1.0/" + options_.group;
  for (const char* kind : {"/NBIRTH/", "/NDEATH/", "/NDATA/"}) client_->subscribe(group + kind + options_.node, 1);
  for (const char* kind : {"/DBIRTH/", "/DDEATH/", "/DDATA/"}) {
    const std::string device = options_.device.empty() ? "+" : options_.device;
    client_->subscribe(group + kind + options_.node + "/" + device, 1);
  }
  ask_for_births();
}

void SparkplugDriver::ask_for_births() {
  if (!client_->connected() || std::exchange(asked_, true)) return;
  const std::string body = encode(rebirth_request(wall_time_ms()));
  Outgoing request;
  request.topic = Topic{options_.group, options_.node, "", Kind::node_command}.text();
  request.payload = body;
  if (const std::string problem = client_->publish(request); !problem.empty())
    lost_->warn("the node is not asked for its birth certificates: " + problem);
}

void SparkplugDriver::received(std::string_view topic_text, std::string_view bytes) {
  const auto topic = parse_topic(topic_text);
  if (!topic || topic->group != options_.group || topic->node != options_.node) return;
  auto payload = decode(bytes);
  if (!payload) return refused_->warn(std::string(topic_text) + " is no payload of Sparkplug B");
  const auto heard = known_.take(*topic, *payload);
  if (heard == Node::Heard::stale) return;
  if (heard == Node::Heard::too_much)
    return refused_->warn(std::string(topic_text) + " is a birth certificate of too many metrics");
  // An instance of one device does not hear the others, whose numbers are missing.
  const bool numbered = options_.device.empty();
  bool unnamed = false;
  for (const Metric& metric : payload->metrics) unnamed = unnamed || metric.name.empty();
  if (heard == Node::Heard::gap && (numbered || unnamed || !known_.is_alive(topic->device))) ask_for_births();
  if (topic->kind != Kind::node_data && topic->kind != Kind::device_data)
    context_->update_metadata({{"alive", known_.is_alive(options_.device) ? "true" : "false"}});
  const bool own = topic->device == options_.device || topic->kind == Kind::node_death;
  if (!active_ || !own) return;
  Message message;
  message.payload = brokers::Payload::copy(json_of(*topic, *payload));
  pending_.push_back(std::move(message));
}

void SparkplugDriver::drain() {
  while (!pending_.empty() && !full_) {
    full_ = context_->publish(metrics_channel, pending_.front()) == PublishStatus::would_block;
    if (!full_) pending_.pop_front();
  }
}

void SparkplugDriver::on_writable(std::string_view) {
  full_ = false;
  drain();
  client_->refresh();
}

void SparkplugDriver::on_message(std::string_view channel, Message message) {
  if (channel != commands_channel) return;
  if (const std::string problem = write(message); !problem.empty()) lost_->warn("a command is lost: " + problem);
  client_->refresh();
}

/// \return why it cannot be written; empty: it is
std::string SparkplugDriver::write(const Message& message) {
  const std::string* name = message.properties.find(metric_property);
  if (name == nullptr) return "it has no property `metric`, which names what it writes";
  if (!client_->connected()) return "the broker is away";
  const auto type = known_.type_of(options_.device, *name);
  if (!type) return "no birth certificate names the metric \"" + *name + "\"";
  Metric metric;
  metric.name = *name;
  metric.type = *type;
  metric.timestamp_ms = wall_time_ms();
  try {
    metric.value = value_of(*type, std::string(message.payload.text()));
  } catch (const std::invalid_argument& e) {
    return e.what();
  }
  sparkplug::Payload payload;
  payload.timestamp_ms = metric.timestamp_ms;
  payload.metrics.push_back(std::move(metric));
  const std::string body = encode(payload);
  Outgoing command;
  const Kind kind = options_.device.empty() ? Kind::node_command : Kind::device_command;
  command.topic = Topic{options_.group, options_.node, options_.device, kind}.text();
  command.payload = body;
  return client_->publish(command);
}

}  // namespace iotcloud::drivers::mqtt::sparkplug
