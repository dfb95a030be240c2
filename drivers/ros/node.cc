#include <atomic>
#include <chrono>
#include <cstring>
#include <exception>
#include <map>
#include <mutex>
#include <thread>
#include <utility>

#include <boost/make_shared.hpp>
#include <ros/advertise_options.h>
#include <ros/serialization.h>
#include <ros/transport_hints.h>

#include <iotcloud/drivers/ros/graph.h>
#include <iotcloud/drivers/ros/node.h>

namespace iotcloud::drivers::ros {

/// The bytes of a message whose type is known when its publisher has said it.
struct RawMessage {
  std::string type = "*", checksum = "*", definition;
  std::vector<std::uint8_t> bytes;
};

}  // namespace iotcloud::drivers::ros

// What roscpp asks of a message's type: "*" subscribes to any.
namespace ros {

using iotcloud::drivers::ros::RawMessage;

namespace message_traits {

template <>
struct IsMessage<RawMessage> : TrueType {};
template <>
struct IsMessage<const RawMessage> : TrueType {};
template <>
struct MD5Sum<RawMessage> {
  static const char* value(const RawMessage& message) { return message.checksum.c_str(); }
  static const char* value() { return "*"; }
};
template <>
struct DataType<RawMessage> {
  static const char* value(const RawMessage& message) { return message.type.c_str(); }
  static const char* value() { return "*"; }
};
template <>
struct Definition<RawMessage> {
  static const char* value(const RawMessage& message) { return message.definition.c_str(); }
};

}  // namespace message_traits

namespace serialization {

template <>
struct Serializer<RawMessage> {
  template <typename Stream>
  static void write(Stream& stream, const RawMessage& message) {
    if (!message.bytes.empty())
      std::memcpy(stream.advance(serializedLength(message)), message.bytes.data(), message.bytes.size());
  }
  template <typename Stream>
  static void read(Stream& stream, RawMessage& message) {
    const std::uint32_t size = stream.getLength();
    const std::uint8_t* data = stream.advance(size);
    message.bytes.assign(data, data + size);
  }
  static std::uint32_t serializedLength(const RawMessage& message) {
    return static_cast<std::uint32_t>(message.bytes.size());
  }
};

template <>
struct PreDeserialize<RawMessage> {
  static void notify(const PreDeserializeParams<RawMessage>& parameters) {
    M_string& head = *parameters.connection_header;
    parameters.message->type = head["type"];
    parameters.message->checksum = head["md5sum"];
    parameters.message->definition = head["message_definition"];
  }
};

}  // namespace serialization
}  // namespace ros

namespace iotcloud::drivers::ros {

using std::chrono::steady_clock;

namespace {

constexpr std::chrono::milliseconds call_limit{1000};
constexpr std::chrono::milliseconds tend_period{1000};
constexpr std::chrono::milliseconds silence{5000};  // of a topic, until the node asks for its publishers' processes
constexpr std::chrono::milliseconds flush_time{50};

}  // namespace

class Node::Impl {
 public:
  Impl(NodeOptions options, NodeEvents events);
  ~Impl();
  bool publish(std::size_t topic, const std::string& bytes);

 private:
  struct Read {
    TopicRecord record;
    ::ros::Subscriber subscriber;
    steady_clock::time_point looked;        ///< the newest message, or look at its publishers
    std::map<std::string, int> publishers;  ///< processes by addresses
  };

  void run();
  /// Does what needs the master, once a second. \return whether the node is registered, and the state to report
  std::pair<bool, std::string> tend();
  void join();
  void subscribe(std::size_t topic);
  bool announce();
  bool look_for_restarts(Read& read);
  bool hears_all() const;
  std::string who_is_missing() const;
  void leave();

  const NodeOptions options_;
  const NodeEvents events_;
  const Master master_{options_.master, call_limit};
  Graph graph_{master_, "iotcloud", "ros.so"};
  std::vector<Read> reads_;
  bool announced_ = false;  ///< the master knows all topics of this node
  std::mutex mutex_;
  std::vector<::ros::Publisher> sent_;       ///< guarded by mutex_; changed by thread_ only
  steady_clock::time_point last_published_;  ///< guarded by mutex_
  std::atomic<bool> ending_ = false;
  std::thread thread_;  ///< last, because it uses the other members
};

Node::Node(NodeOptions options, NodeEvents events)
    : impl_(std::make_unique<Impl>(std::move(options), std::move(events))) {}

Node::~Node() = default;

bool Node::publish(std::size_t topic, const std::string& bytes) {
  return impl_->publish(topic, bytes);
}

Node::Impl::Impl(NodeOptions options, NodeEvents events) : options_(std::move(options)), events_(std::move(events)) {
  reads_.resize(options_.read.size());
  thread_ = std::thread([this] { run(); });
}

Node::Impl::~Impl() {
  ending_ = true;
  thread_.join();
}

bool Node::Impl::publish(std::size_t topic, const std::string& bytes) {
  const SentTopic& sent = options_.sent[topic];
  RawMessage message;
  message.type = sent.type;
  message.checksum = sent.checksum;
  message.bytes.assign(bytes.begin(), bytes.end());
  const std::lock_guard lock(mutex_);
  if (sent_.empty()) return false;
  sent_[topic].publish(message);
  last_published_ = steady_clock::now();
  return true;
}

void Node::Impl::run() {
  try {
    std::pair<bool, std::string> said;
    auto next_tend = steady_clock::now();
    while (!ending_) {
      if (steady_clock::now() >= next_tend) {
        if (auto state = tend(); state != said) {
          said = std::move(state);
          events_.on_state(said.first, said.second);
        }
        next_tend = steady_clock::now() + tend_period;
      }
      graph_.work();
    }
  } catch (const std::exception& e) {
    events_.on_failed(e.what());
  }
  leave();
}

std::pair<bool, std::string> Node::Impl::tend() {
  const std::string at = " the ROS master at " + master_.address().uri;
  if (const std::string problem = master_.unreachable(); !problem.empty()) {
    announced_ = false;
    if (!graph_.has_joined()) return {false, "waits for" + at + ": " + problem};
    return {false, at.substr(1) + " is away (" + problem + "); what is connected goes on"};
  }
  if (!graph_.has_joined()) join();
  if (announced_) announced_ = master_.knows(Graph::name()) == Master::Known::yes && hears_all();
  for (std::size_t i = 0; i < reads_.size(); ++i) {
    if (!look_for_restarts(reads_[i])) continue;
    subscribe(i);
    announced_ = false;
  }
  if (!announced_) announced_ = announce();
  if (!announced_) return {false, Graph::name() + " is not yet registered with" + at};
  return {true, Graph::name() + " is registered with" + at + who_is_missing()};
}

/// Called when the master answers for the first time.
void Node::Impl::join() {
  graph_.join();
  std::vector<::ros::Publisher> sent;
  for (const SentTopic& topic : options_.sent) {
    ::ros::AdvertiseOptions advertised(topic.topic, options_.queue, topic.checksum, topic.type, topic.definition);
    advertised.latch = topic.latch;
    sent.push_back(graph_.handle().advertise(advertised));
  }
  for (std::size_t i = 0; i < reads_.size(); ++i) subscribe(i);
  const std::lock_guard lock(mutex_);
  sent_ = std::move(sent);
}

void Node::Impl::subscribe(std::size_t topic) {
  Read& read = reads_[topic];
  read.subscriber.shutdown();
  read.subscriber = graph_.handle().subscribe<RawMessage>(
      options_.read[topic], options_.queue,
      [this, topic](const boost::shared_ptr<const RawMessage>& message) {
        reads_[topic].looked = steady_clock::now();
        events_.on_message({topic, message->type, message->checksum, message->definition, message->bytes.data(),
                            message->bytes.size()});
      },
      {}, ::ros::TransportHints().tcpNoDelay());
  read.record = {read.subscriber.getTopic(), "*"};
  read.looked = steady_clock::now();
  read.publishers.clear();
}

/// Tells the master this node's topics: at first, again after the master was away, and while nobody publishes a topic
/// that the node reads, because the answer lists the publishers.
bool Node::Impl::announce() {
  const std::string uri = Graph::uri();
  bool done = true;
  for (const Read& read : reads_) done &= master_.register_subscriber(Graph::name(), read.record, uri);
  for (std::size_t i = 0; i < sent_.size(); ++i)
    done &= master_.register_publisher(Graph::name(), {sent_[i].getTopic(), options_.sent[i].type}, uri);
  return done;
}

/// roscpp asks a publisher only once where its messages come from: one that was killed and started again with the same
/// address of its node, but another port for its messages, would never be heard again. Its process has another number.
/// \return whether there is one, so that the subscription is to be made anew
bool Node::Impl::look_for_restarts(Read& read) {
  const auto now = steady_clock::now();
  if (!read.publishers.empty() && now - read.looked < silence) return false;
  read.looked = now;
  std::map<std::string, int> present;
  bool restarted = false;
  for (const std::string& uri : master_.publishers_of(Graph::name(), read.record, Graph::uri())) {
    const auto process = master_.process_at(uri);
    if (!process) continue;
    const auto known = read.publishers.find(uri);
    restarted |= known != read.publishers.end() && known->second != *process;
    present.emplace(uri, *process);
  }
  for (const auto& [uri, process] : present) read.publishers[uri] = process;
  return restarted;
}

bool Node::Impl::hears_all() const {
  for (const Read& read : reads_) {
    if (read.subscriber.getNumPublishers() == 0) return false;
  }
  return true;
}

std::string Node::Impl::who_is_missing() const {
  std::string missing;
  for (const Read& read : reads_) {
    if (read.subscriber.getNumPublishers() == 0) missing += "; nobody publishes " + read.record.topic;
  }
  for (const ::ros::Publisher& sent : sent_) {
    if (sent.getNumSubscribers() == 0) missing += "; nobody reads " + sent.getTopic();
  }
  return missing;
}

void Node::Impl::leave() {
  std::vector<::ros::Publisher> sent;
  steady_clock::time_point last;
  {
    const std::lock_guard lock(mutex_);
    sent.swap(sent_);
    last = last_published_;
  }
  if (!graph_.has_joined()) return;
  // roscpp passes the last message to the kernel soon, but does not say when.
  std::this_thread::sleep_until(last + flush_time);
  graph_.leave();
  reads_.clear();
}

}  // namespace iotcloud::drivers::ros
