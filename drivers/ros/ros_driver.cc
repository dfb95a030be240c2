#include <algorithm>
#include <cstdlib>
#include <span>
#include <stdexcept>
#include <utility>

#include <iotcloud/drivers/property_reader.h>
#include <iotcloud/drivers/ros/ros_driver.h>

namespace iotcloud::drivers::ros {

namespace {

std::string without_blanks(const std::string& text) {
  const auto first = text.find_first_not_of(" \t\n");
  if (first == std::string::npos) return "";
  return text.substr(first, text.find_last_not_of(" \t\n") - first + 1);
}

std::vector<std::string> message_folders(const std::string& given) {
  if (!given.empty()) return words_of(given, ':');
  const char* packages = std::getenv("ROS_PACKAGE_PATH");
  std::vector<std::string> folders = words_of(packages ? packages : "", ':');
  folders.insert(folders.end(), {"/opt/ros/noetic/share", "/usr/share"});
  return folders;
}

}  // namespace

std::vector<TopicEntry> read_topics(const std::string& property, const std::string& text, const std::string& fallback) {
  std::vector<TopicEntry> all;
  for (const std::string& word : words_of(text)) {
    const auto equals = word.find('=');
    TopicEntry entry{without_blanks(word.substr(0, equals)), fallback};
    if (equals != std::string::npos) entry.value = without_blanks(word.substr(equals + 1));
    std::string problem = problem_of_topic(entry.topic);
    if (entry.topic.empty()) problem = "it names no topic";
    if (problem.empty() && entry.value.empty()) problem = "there is nothing behind the =";
    for (const TopicEntry& other : all) {
      if (other.topic == entry.topic) problem = "the topic stands there twice";
    }
    if (!problem.empty()) {
      throw std::invalid_argument("property \"" + property + "\" has \"" + word + "\"; it takes " +
                                  (fallback.empty() ? "TOPIC=TYPE, such as /cmd_vel=geometry_msgs/Twist"
                                                    : "TOPIC or TOPIC=CHANNEL, such as /odom=odometry") +
                                  ": " + problem);
    }
    all.push_back(std::move(entry));
  }
  return all;
}

RosDriver::Options RosDriver::read_options(const PropertyMap& properties) {
  constexpr int longest_queue = 100'000;
  PropertyReader reader(properties);
  Options options;
  const std::string master = reader.text("ros_master", "");
  options.master = parse_master_address(master.empty() ? default_master() : master);
  options.subscribe = read_topics("subscribe", reader.text("subscribe", ""), std::string(messages_channel));
  options.publish = read_topics("publish", reader.text("publish", ""), "");
  options.raw = reader.choice("format", "json", {"json", "raw"}) == "raw";
  const std::vector<std::string> folders = message_folders(reader.text("msg_path", ""));
  options.latch = reader.flag("latch", false);
  options.most_bytes = stream::read_most_bytes(reader);
  options.queue = static_cast<std::uint32_t>(reader.integer("queue", 100, 1, longest_queue));
  options.broker = reader.text("broker", "");
  if (options.subscribe.empty() && options.publish.empty())
    throw std::invalid_argument("give one of the properties \"subscribe\" and \"publish\", or both");
  for (const TopicEntry& topic : options.subscribe) {
    if (topic.value == publish_channel || topic.value.find('/') != std::string::npos) {
      throw std::invalid_argument("property \"subscribe\" has the channel \"" + topic.value +
                                  "\"; it takes any but \"publish\" and those with a slash");
    }
  }
  for (const TopicEntry& topic : options.publish) {
    try {
      options.types.push_back(MessageType::load(topic.value, folders));
    } catch (const DefinitionError& e) {
      throw std::invalid_argument("property \"publish\" has " + topic.topic + "=" + topic.value + ": " + e.what());
    }
  }
  return options;
}

std::vector<ChannelSpec> RosDriver::channels(const PropertyMap& properties) {
  options_ = read_options(properties);
  std::set<std::string> names;
  for (const TopicEntry& topic : options_.subscribe) names.insert(topic.value);
  std::vector<ChannelSpec> specs;
  for (const std::string& name : names) {
    ChannelSpec spec;
    spec.name = name;
    spec.broker = options_.broker;
    specs.push_back(spec);
  }
  if (!options_.publish.empty()) {
    ChannelSpec commands;
    commands.name = publish_channel;
    commands.direction = Direction::in;
    commands.broker = options_.broker;
    specs.push_back(commands);
  }
  return specs;
}

void RosDriver::open(DriverContext& context) {
  context_ = &context;
  refused_.emplace(context);
  left_out_.emplace(context);
  lost_.emplace(context);
  state_.emplace(context);
  inlets_.resize(options_.subscribe.size());
  NodeOptions node;
  node.master = options_.master;
  node.queue = options_.queue;
  for (const TopicEntry& topic : options_.subscribe) node.read.push_back(topic.topic);
  for (std::size_t i = 0; i < options_.publish.size(); ++i) {
    const MessageType& type = options_.types[i];
    node.sent.push_back({options_.publish[i].topic, type.name(), type.checksum(), type.definition(), options_.latch});
  }
  NodeEvents events;
  events.on_message = [this](const NodeMessage& message) { take(message); };
  events.on_state = [this](bool registered, const std::string& state) {
    context_->post([this, registered, state] { tell(registered, state); });
  };
  events.on_failed = [this](const std::string& reason) { context_->fail(reason); };
  node_ = std::make_unique<Node>(std::move(node), std::move(events));
}

void RosDriver::activate() {
  const std::lock_guard lock(mutex_);
  active_ = true;
}

void RosDriver::deactivate() {
  const std::lock_guard lock(mutex_);
  active_ = false;
}

void RosDriver::close() {
  node_.reset();
}

void RosDriver::tell(bool registered, const std::string& state) {
  context_->log(LogLevel::info, "ROS: " + state);
  if (registered) {
    state_->connected({{"ros", state}});
  } else {
    context_->update_metadata({{"ros", ""}});
    state_->away(state);
  }
}

Payload RosDriver::converted(Inlet& inlet, const NodeMessage& message) const {
  const std::span bytes(reinterpret_cast<const std::byte*>(message.data), message.size);
  if (options_.raw) {
    if (message.size > options_.most_bytes)
      throw FormatError("it has " + std::to_string(message.size) + " bytes, more than most_bytes");
    return Payload::copy(bytes);
  }
  if (inlet.definition != message.definition || inlet.type_name != message.type) {
    inlet.definition = message.definition;
    inlet.type_name = message.type;
    inlet.type.reset();
    inlet.problem.clear();
    try {
      inlet.type = MessageType::parse(message.type, message.definition);
    } catch (const DefinitionError& e) {
      inlet.problem = e.what();
    }
    if (message.definition.empty() && message.size > 0) {
      inlet.type.reset();
      inlet.problem = "its publisher does not send the definition of its type; format raw takes it";
    }
  }
  if (!inlet.type) throw FormatError(inlet.problem);
  return Payload::take(inlet.type->to_json(bytes, options_.most_bytes));
}

void RosDriver::take(const NodeMessage& message) {
  const TopicEntry& topic = options_.subscribe[message.topic];
  Inlet& inlet = inlets_[message.topic];
  Message made;
  try {
    made.payload = converted(inlet, message);
  } catch (const FormatError& e) {
    return refused_->warn("a message of " + topic.topic + " (" + message.type + ") is refused: " + e.what());
  }
  made.properties.set(topic_property, topic.topic);
  made.properties.set(type_property, message.type);
  if (options_.raw) made.properties.set(md5sum_property, message.checksum);
  bool dropped = false, tells = false;
  {
    const std::lock_guard lock(mutex_);
    if (!active_) return;
    dropped = inlet.waiting.size() >= options_.queue;
    if (dropped) inlet.waiting.pop_front();
    inlet.waiting.push_back(std::move(made));
    tells = !std::exchange(told_, true);
  }
  if (dropped) left_out_->warn("a message of " + topic.topic + " is left out: the channel is full (queue)");
  if (tells) context_->post([this] { drain(); });
}

void RosDriver::drain() {
  std::unique_lock lock(mutex_);
  told_ = false;
  for (std::size_t i = 0; i < inlets_.size(); ++i) {
    const std::string& channel = options_.subscribe[i].value;
    std::deque<Message>& waiting = inlets_[i].waiting;
    while (!waiting.empty() && !full_.contains(channel)) {
      // The lock is held: otherwise the node's thread might take the oldest message away meanwhile.
      if (context_->publish(channel, waiting.front()) == PublishStatus::would_block) {
        full_.insert(channel);
      } else {
        waiting.pop_front();
      }
    }
  }
}

void RosDriver::on_writable(std::string_view channel) {
  if (const auto full = full_.find(channel); full != full_.end()) full_.erase(full);
  drain();
}

void RosDriver::on_message(std::string_view channel, Message message) {
  if (channel != publish_channel) return;
  std::string problem;
  try {
    problem = send(message);
  } catch (const FormatError& e) {
    problem = e.what();
  }
  if (!problem.empty()) lost_->warn("a message for ROS is lost: " + problem);
}

std::string RosDriver::send(const Message& message) {
  const std::string* wanted = message.properties.find(topic_property);
  std::size_t index = 0;
  if (wanted) {
    while (index < options_.publish.size() && options_.publish[index].topic != *wanted) ++index;
    if (index == options_.publish.size()) return "the property publish has no topic \"" + *wanted + "\"";
  } else if (options_.publish.size() > 1) {
    return "nobody knows its topic: the property publish has several, and the message has no property topic";
  }
  const MessageType& type = options_.types[index];
  std::string bytes;
  if (options_.raw) {
    if (message.payload.size() > options_.most_bytes) return "it is longer than most_bytes";
    constexpr std::size_t any = std::size_t{1} << 30;
    type.to_json(message.payload.bytes(), any);  // refuses what is no such message
    bytes = message.payload.text();
  } else {
    bytes = type.from_json(message.payload.text(), options_.most_bytes);
  }
  return node_->publish(index, bytes) ? "" : "there has been no ROS master yet";
}

}  // namespace iotcloud::drivers::ros
