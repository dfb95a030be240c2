#include <stdexcept>
#include <utility>

#include <mosquitto.h>

#include <iotcloud/drivers/mqtt/finder/mqtt_finder.h>

namespace iotcloud::drivers::mqtt {

namespace {

constexpr std::chrono::seconds asking_pause{10};
constexpr std::size_t most_listed_metrics = 40;

std::string key_of(const sparkplug::Topic& topic) {
  const std::string key = "sparkplug " + topic.group + "/" + topic.node;
  return topic.device.empty() ? key : key + "/" + topic.device;
}

}  // namespace

MqttFinder::Options MqttFinder::read_options(const PropertyMap& properties) {
  PropertyReader reader(properties);
  Options options;
  options.client = ClientOptions::read(reader);
  options.prefix = reader.text("homeassistant_prefix", "homeassistant");
  options.announcements = reader.text("announcements", "");
  const std::string find = reader.text("find", "");
  bool plain = false;
  for (const std::string& word : words_of(find)) {
    if (word == "homeassistant") {
      options.homeassistant = true;
    } else if (word == "sparkplug") {
      options.sparkplug = true;
    } else if (word == "announcements") {
      plain = true;
    } else {
      throw std::invalid_argument("property \"find\" has \"" + word +
                                  "\"; it takes homeassistant, sparkplug and announcements");
    }
  }
  if (!options.homeassistant && !options.sparkplug && !plain)
    throw std::invalid_argument("property \"find\" names nothing; it takes homeassistant, sparkplug and announcements");
  if (plain != !options.announcements.empty())
    throw std::invalid_argument(
        "the property \"announcements\" names the topics of announcements, which \"find\" asks for: give both or none");
  if (plain && mosquitto_sub_topic_check(options.announcements.c_str()) != MOSQ_ERR_SUCCESS)
    throw std::invalid_argument("property \"announcements\" is \"" + options.announcements +
                                "\"; it takes a filter of topics, such as devices/+/hello");
  if (options.prefix.empty() || mosquitto_pub_topic_check(options.prefix.c_str()) != MOSQ_ERR_SUCCESS)
    throw std::invalid_argument("property \"homeassistant_prefix\" is \"" + options.prefix + "\", which is no topic");
  return options;
}

std::vector<ChannelSpec> MqttFinder::channels(const PropertyMap& properties) {
  options_ = read_options(properties);
  return {};
}

void MqttFinder::open(DriverContext& context) {
  context_ = &context;
  passed_over_.emplace(context);
  Findings findings{[this](const std::string& key, const PropertyMap& what) { context_->report_found(key, what); },
                    [this](const std::string& key) { context_->report_gone(key); },
                    [this](const std::string& text) { passed_over_->warn(text); }};
  plain_.emplace(findings);
  homeassistant_.emplace(options_.prefix, findings);
  Client::Events events;
  events.on_connected = [this] { connected(); };
  events.on_message = [this](const auto& message, const auto*) {
    received(message.topic, {static_cast<const char*>(message.payload), static_cast<std::size_t>(message.payloadlen)},
             message.retain);
  };
  events.on_away = [this](const std::string&) { context_->report_sight(false); };
  client_.emplace(context, options_.client, std::move(events));
  context.every(asking_pause, [this] { asked_.clear(); });
  client_->connect();
}

/// All retained announcements come again, so what does not come is gone.
void MqttFinder::connected() {
  homeassistant_->clear();
  nodes_.clear();
  known_ = 0;
  devices_.clear();
  asked_.clear();
  context_->report_sight(true);
  if (options_.homeassistant) client_->subscribe(homeassistant_->filter(), 1);
  if (!options_.announcements.empty()) client_->subscribe(options_.announcements, 1);
  if (options_.sparkplug) client_->subscribe("spBv1.0/#", 1);
}

void MqttFinder::received(const std::string& topic, std::string_view payload, bool retained) {
  if (options_.sparkplug) {
    if (const auto of_sparkplug = sparkplug::parse_topic(topic)) {
      // Certificates and data are never retained: somebody who did that would bring a dead node back.
      if (!retained) sparkplug_received(*of_sparkplug, payload);
      return;
    }
  }
  if (options_.homeassistant && homeassistant_->is_announcement(topic)) return homeassistant_->take(topic, payload);
  if (options_.announcements.empty()) return;
  bool matches = false;
  mosquitto_topic_matches_sub(options_.announcements.c_str(), topic.c_str(), &matches);
  if (matches) plain_->take(topic, payload);
}

void MqttFinder::sparkplug_received(const sparkplug::Topic& topic, std::string_view bytes) {
  using sparkplug::Kind;
  if (topic.kind == Kind::node_command || topic.kind == Kind::device_command) return;
  auto payload = sparkplug::decode(bytes);
  if (!payload) return passed_over_->warn("\"" + topic.text() + "\" has no payload of Sparkplug B");
  const NodeName name{topic.group, topic.node};
  if (!nodes_.contains(name) && nodes_.size() >= most_nodes)
    return passed_over_->warn("there are more than " + std::to_string(most_nodes) + " nodes of Sparkplug B");
  sparkplug::Node& node = nodes_[name];
  known_ -= node.bytes();
  const auto heard = node.take(topic, *payload);
  known_ += node.bytes();
  if (heard == sparkplug::Node::Heard::stale) return;
  if (heard == sparkplug::Node::Heard::too_much)
    return passed_over_->warn("\"" + topic.text() + "\" is a birth certificate of too many metrics");
  if (known_ > most_known) {
    passed_over_->warn("the nodes of Sparkplug B name too many metrics; \"" + topic.node + "\" is passed over");
    return forget_node(name);
  }
  if (heard == sparkplug::Node::Heard::gap) ask_for_births(name);
  switch (topic.kind) {
    case Kind::node_birth:
      for (const auto& device : devices_[name]) gone_sparkplug({topic.group, topic.node, device, Kind::device_death});
      devices_[name].clear();
      found_sparkplug(topic, *payload);
      break;
    case Kind::device_birth:
      devices_[name].insert(topic.device);
      found_sparkplug(topic, *payload);
      break;
    case Kind::device_death:
      devices_[name].erase(topic.device);
      gone_sparkplug(topic);
      break;
    case Kind::node_death:
      forget_node(name);
      break;
    default:
      break;
  }
}

/// The node and its devices are gone.
void MqttFinder::forget_node(const NodeName& node) {
  using sparkplug::Kind;
  for (const auto& device : devices_[node]) gone_sparkplug({node.first, node.second, device, Kind::device_death});
  devices_.erase(node);
  known_ -= nodes_[node].bytes();
  nodes_.erase(node);
  gone_sparkplug({node.first, node.second, "", Kind::node_death});
}

void MqttFinder::found_sparkplug(const sparkplug::Topic& topic, const sparkplug::Payload& payload) {
  PropertyMap attributes{{"kind", topic.device.empty() ? "sparkplug-node" : "sparkplug-device"},
                         {"group", topic.group},
                         {"node", topic.node},
                         {"id", topic.device.empty() ? topic.node : topic.device}};
  if (!topic.device.empty()) attributes["device"] = topic.device;
  // What a device says about itself, such as Properties/Hardware Make, is text.
  constexpr std::string_view about = "Properties/";
  for (const auto& metric : payload.metrics) {
    const auto* text = std::get_if<std::string>(&metric.value);
    if (text == nullptr || metric.is_opaque || !metric.name.starts_with(about)) continue;
    if (attributes.size() >= most_listed_metrics) break;
    std::string name = "property." + metric.name.substr(about.size());
    for (char& c : name) {
      if (c == ' ' || c == '/') c = '_';
    }
    attributes[name] = *text;
  }
  context_->report_found(key_of(topic), attributes);
}

void MqttFinder::gone_sparkplug(const sparkplug::Topic& topic) {
  context_->report_gone(key_of(topic));
}

void MqttFinder::ask_for_births(const NodeName& node) {
  if (!client_->connected() || !asked_.insert(node).second) return;
  const std::string body = sparkplug::encode(sparkplug::rebirth_request(sparkplug::wall_time_ms()));
  Outgoing request;
  request.topic = sparkplug::Topic{node.first, node.second, "", sparkplug::Kind::node_command}.text();
  request.payload = body;
  if (const std::string problem = client_->publish(request); !problem.empty())
    passed_over_->warn("a node of Sparkplug B is not asked for its birth certificates: " + problem);
}

}  // namespace iotcloud::drivers::mqtt
