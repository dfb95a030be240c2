#include <cstdlib>
#include <stdexcept>
#include <utility>

#include <mosquitto.h>
#include <mqtt_protocol.h>

#include <iotcloud/drivers/mqtt/mqtt_driver.h>

namespace iotcloud::drivers::mqtt {

namespace {

/// The filter of topics in that of a subscription: "a/#" of "$share/group/a/#".
const char* pattern_of(const std::string& filter) {
  constexpr std::string_view shared = "$share/";
  const auto slash = filter.starts_with(shared) ? filter.find('/', shared.size()) : std::string::npos;
  return slash == std::string::npos ? filter.c_str() : filter.c_str() + slash + 1;
}

}  // namespace

std::vector<Subscription> read_subscriptions(const std::string& text) {
  std::vector<Subscription> all;
  for (const std::string& word : words_of(text)) {
    const auto equals = word.rfind('=');
    Subscription subscription{word.substr(0, equals), std::string(MqttDriver::messages_channel)};
    if (equals != std::string::npos) subscription.channel = word.substr(equals + 1);
    const bool good = mosquitto_sub_topic_check(subscription.filter.c_str()) == MOSQ_ERR_SUCCESS;
    if (!good || subscription.filter.empty() || subscription.channel.empty() ||
        subscription.channel == MqttDriver::publish_channel || subscription.channel.find('/') != std::string::npos) {
      throw std::invalid_argument(
          "property \"subscribe\" has \"" + word +
          "\"; it takes FILTER or FILTER=CHANNEL, such as sensors/+/temperature=temperature, and "
          "no channel \"publish\"");
    }
    all.push_back(std::move(subscription));
  }
  return all;
}

std::map<std::string, std::string, std::less<>> read_targets(const std::string& text) {
  std::map<std::string, std::string, std::less<>> all;
  for (const std::string& word : words_of(text)) {
    const auto equals = word.rfind('=');
    const std::string topic = word.substr(0, equals);
    const std::string name = equals == std::string::npos ? "" : word.substr(equals + 1);
    if (topic.empty() || name.empty() || mosquitto_pub_topic_check(topic.c_str()) != MOSQ_ERR_SUCCESS ||
        !all.emplace(name, topic).second) {
      throw std::invalid_argument("property \"publish_to\" has \"" + word +
                                  "\"; it takes TOPIC=NAME, such as lamp/set=lamp, and each name once");
    }
  }
  return all;
}

MqttDriver::Options MqttDriver::read_options(const PropertyMap& properties) {
  constexpr int most = 64 << 20;
  PropertyReader reader(properties);
  Options options;
  options.client = ClientOptions::read(reader);
  options.subscriptions = read_subscriptions(reader.text("subscribe", ""));
  options.qos = std::stoi(reader.choice("qos", "1", {"0", "1", "2"}));
  options.publish_topic = reader.text("publish_topic", "");
  options.publish_to = read_targets(reader.text("publish_to", ""));
  options.publish_qos = std::stoi(reader.choice("publish_qos", "1", {"0", "1", "2"}));
  options.availability = reader.text("availability", "");
  options.available = reader.text("available", "online");
  options.not_available = reader.text("not_available", "offline");
  options.unsent_bytes = static_cast<std::size_t>(reader.integer("unsent_bytes", 1 << 20, 1, most));
  options.keeps = reader.choice("while_away", "drop", {"drop", "keep"}) == "keep";
  options.broker = reader.text("broker", "");
  if (!options.availability.empty() && mosquitto_pub_topic_check(options.availability.c_str()) != MOSQ_ERR_SUCCESS)
    throw std::invalid_argument("property \"availability\" is \"" + options.availability + "\", which is no topic");
  return options;
}

std::vector<ChannelSpec> MqttDriver::channels(const PropertyMap& properties) {
  options_ = read_options(properties);
  std::vector<ChannelSpec> specs;
  std::set<std::string> names;
  for (const Subscription& subscription : options_.subscriptions) names.insert(subscription.channel);
  for (const std::string& name : names) {
    ChannelSpec spec;
    spec.name = name;
    spec.broker = options_.broker;
    specs.push_back(spec);
  }
  ChannelSpec commands;
  commands.name = publish_channel;
  commands.direction = Direction::in;
  commands.broker = options_.broker;
  specs.push_back(commands);
  return specs;
}

void MqttDriver::open(DriverContext& context) {
  context_ = &context;
  lost_.emplace(context);
  refused_.emplace(context);
  Client::Events events;
  events.on_connected = [this] { connected(); };
  events.on_message = [this](const auto& message, const auto* properties) { received(message, properties); };
  events.on_away = [this](const std::string& reason) { away(reason); };
  events.on_sent = [this](int number) { sent(number); };
  events.after_step = [this] { drain(); };
  events.may_read = [this] { return pending_.empty(); };
  client_.emplace(context, options_.client, std::move(events));
  client_->connect();
}

void MqttDriver::connected() {
  for (const Subscription& subscription : options_.subscriptions) client_->subscribe(subscription.filter, options_.qos);
  if (!options_.availability.empty()) client_->subscribe(options_.availability, options_.qos);
  waiting_bytes_ = 0;
  for (const Message& message : std::exchange(waiting_, {})) {
    if (const std::string problem = send(message); !problem.empty())
      lost_->warn("a message that waited is lost: " + problem);
  }
}

void MqttDriver::received(const mosquitto_message& message, const mqtt5__property* properties) {
  const std::string_view text(static_cast<const char*>(message.payload), static_cast<std::size_t>(message.payloadlen));
  const bool of_availability = options_.availability == message.topic;
  if (of_availability && (text == options_.available || text == options_.not_available))
    context_->update_metadata({{"available", text == options_.available ? "true" : "false"}});
  if (!active_) return;
  for (const Subscription& subscription : options_.subscriptions) {
    bool matches = false;
    mosquitto_topic_matches_sub(pattern_of(subscription.filter), message.topic, &matches);
    if (!matches) continue;
    Message made;
    made.payload = Payload::copy(text);
    const mosquitto_property* at = properties;
    char *name = nullptr, *value = nullptr;
    for (bool first = true;
         (at = mosquitto_property_read_string_pair(at, MQTT_PROP_USER_PROPERTY, &name, &value, !first));
         first = false) {
      made.properties.set(name, value);
      std::free(name);
      std::free(value);
    }
    made.properties.set(topic_property, message.topic);
    if (message.retain) made.properties.set(retain_property, "true");
    pending_.emplace_back(subscription.channel, std::move(made));
    return;
  }
  if (of_availability) return;
  refused_->warn(std::string("a message of ") + message.topic + " has a topic of no filter: an earlier session's?");
}

void MqttDriver::drain() {
  std::erase_if(pending_, [this](auto& waiting) {
    if (full_.contains(waiting.first)) return false;
    if (context_->publish(waiting.first, waiting.second) != PublishStatus::would_block) return true;
    full_.insert(waiting.first);
    return false;
  });
}

void MqttDriver::on_writable(std::string_view channel) {
  if (const auto full = full_.find(channel); full != full_.end()) full_.erase(full);
  drain();
  client_->refresh();
}

void MqttDriver::away(const std::string& reason) {
  if (options_.publish_qos == 0) {  // the library forgets those
    if (!unconfirmed_.empty()) lost_->warn(std::to_string(unconfirmed_.size()) + " messages may be lost: " + reason);
    unconfirmed_.clear();
    unconfirmed_bytes_ = 0;
  }
}

void MqttDriver::on_message(std::string_view channel, Message message) {
  if (channel != publish_channel) return;
  std::string problem;
  if (client_->connected()) {
    problem = send(message);
    client_->refresh();
  } else if (!options_.keeps) {
    problem = "the broker is away (while_away is drop)";
  } else if (waiting_bytes_ + message.payload.size() > options_.unsent_bytes) {
    problem = "the broker is away, and others wait (unsent_bytes)";
  } else {
    waiting_bytes_ += message.payload.size();
    waiting_.push_back(std::move(message));
  }
  if (!problem.empty()) lost_->warn("a message for the broker is lost: " + problem);
}

/// \return why nobody knows it; empty: `topic` has it
std::string MqttDriver::topic_of(const Message& message, std::string& topic) const {
  if (const std::string* own = message.properties.find(topic_property)) {
    topic = *own;
  } else if (const std::string* to = message.properties.find(to_property)) {
    const auto found = options_.publish_to.find(*to);
    if (found == options_.publish_to.end()) return "the property publish_to has no topic for \"" + *to + "\"";
    topic = found->second;
  } else {
    topic = options_.publish_topic;
  }
  if (topic.empty())
    return "nobody knows its topic: give the property publish_topic, or the message the property topic";
  return "";
}

std::string MqttDriver::send(const Message& message) {
  Outgoing outgoing;
  if (std::string problem = topic_of(message, outgoing.topic); !problem.empty()) return problem;
  if (unconfirmed_bytes_ + message.payload.size() > options_.unsent_bytes)
    return "the broker takes messages too slowly (unsent_bytes)";
  outgoing.payload = message.payload.text();
  outgoing.qos = options_.publish_qos;
  for (const auto& [name, value] : message.properties) {
    if (name == topic_property || name == to_property) continue;
    if (name == retain_property) {
      outgoing.retain = value == "true";
    } else {
      outgoing.user_properties[std::string(name)] = value;
    }
  }
  int number = 0;
  if (std::string problem = client_->publish(outgoing, number); !problem.empty()) return problem;
  if (number == 0) return "";
  unconfirmed_[number] = message.payload.size();
  unconfirmed_bytes_ += message.payload.size();
  return "";
}

void MqttDriver::sent(int number) {
  const auto found = unconfirmed_.find(number);
  if (found == unconfirmed_.end()) return;
  unconfirmed_bytes_ -= found->second;
  unconfirmed_.erase(found);
}

void MqttDriver::close() {
  client_.reset();
}

}  // namespace iotcloud::drivers::mqtt
