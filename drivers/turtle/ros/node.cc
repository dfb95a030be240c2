#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <utility>

#include <geometry_msgs/Twist.h>
#include <nav_msgs/Odometry.h>
#include <sensor_msgs/Image.h>

#include <iotcloud/drivers/ros/graph.h>
#include <iotcloud/drivers/turtle/ros/node.h>

namespace iotcloud::drivers::turtle::ros {

using drivers::ros::Graph;
using drivers::ros::Master;
using drivers::ros::MasterAddress;
using drivers::ros::TopicRecord;
using std::chrono::steady_clock;

namespace {

constexpr std::chrono::milliseconds call_limit{1000};
constexpr std::chrono::milliseconds tend_period{1000};
constexpr std::chrono::milliseconds silence{2000};  // of a camera, until the state says so
constexpr std::chrono::milliseconds renewal{5000};  // of the subscription to a topic that is silent
constexpr std::chrono::milliseconds flush_time{50};
template <typename RosMessage>
TopicRecord record_of(const std::string& topic) {
  return {topic, ::ros::message_traits::datatype<RosMessage>()};
}

NodeImage plain(const sensor_msgs::Image& image) {
  return {image.header.stamp.toSec(), image.width,       image.height,     image.step, image.encoding,
          image.is_bigendian != 0,    image.data.data(), image.data.size()};
}

NodeOdometry plain(const nav_msgs::Odometry& odometry) {
  const auto vector = [](const auto& from) { return std::array<double, 3>{from.x, from.y, from.z}; };
  const auto& pose = odometry.pose.pose;
  const auto& turned = pose.orientation;
  return {odometry.header.stamp.toSec(),
          odometry.header.frame_id,
          vector(pose.position),
          {turned.x, turned.y, turned.z, turned.w},
          vector(odometry.twist.twist.linear),
          vector(odometry.twist.twist.angular)};
}

}  // namespace

class RosNode::Impl {
 public:
  Impl(MasterAddress master, NodeTopics topics, NodeEvents events);
  ~Impl();
  void publish(double linear, double angular);

 private:
  /// A topic that the node reads. Used on the node's thread only.
  struct ReadTopic {
    ::ros::Subscriber subscriber;
    steady_clock::time_point heard;       ///< the newest message, or the first subscription
    steady_clock::time_point subscribed;  ///< the newest subscription

    bool has_publishers() const { return subscriber.getNumPublishers() > 0; }
    void set(const ::ros::Subscriber& now) {
      subscriber = now;
      subscribed = steady_clock::now();
      if (heard == steady_clock::time_point{}) heard = subscribed;
    }
    /// Ends the subscription when roscpp believes in a publisher from which nothing comes. roscpp asks a publisher only
    /// once where its messages come from: one that was killed and started again with the same address of its node, but
    /// another port for its messages, would never be heard again.
    /// \return whether it ended, so that announce() is to subscribe again.
    bool end_if_silent() {
      const auto now = steady_clock::now();
      if (!subscriber || !has_publishers() || now - std::max(heard, subscribed) < renewal) return false;
      subscriber.shutdown();
      subscriber = {};
      return true;
    }
  };

  void run();
  /// Does what needs the master, once a second. \return the state to report.
  std::string tend();
  void join_graph();
  bool announce();
  void leave_graph();
  bool hears_all() const;
  std::string who_is_missing() const;

  const Master master_;
  const NodeTopics topics_;
  const NodeEvents events_;
  Graph graph_{master_, "iotcloud_turtle", "turtle_ros.so"};
  ReadTopic images_, odometry_;
  bool announced_ = false;  ///< the master knows all topics of this node
  std::mutex mutex_;
  ::ros::Publisher velocity_;                ///< guarded by mutex_; changed by thread_ only
  steady_clock::time_point last_published_;  ///< guarded by mutex_
  std::atomic<bool> ending_ = false;
  std::thread thread_;  ///< last, because it uses the other members
};

RosNode::RosNode(MasterAddress master, NodeTopics topics, NodeEvents events)
    : impl_(std::make_unique<Impl>(std::move(master), std::move(topics), std::move(events))) {}

RosNode::~RosNode() = default;

void RosNode::publish(double linear, double angular) {
  impl_->publish(linear, angular);
}

RosNode::Impl::Impl(MasterAddress master, NodeTopics topics, NodeEvents events)
    : master_(std::move(master), call_limit), topics_(std::move(topics)), events_(std::move(events)) {
  thread_ = std::thread([this] { run(); });
}

RosNode::Impl::~Impl() {
  ending_ = true;
  thread_.join();
}

void RosNode::Impl::publish(double linear, double angular) {
  geometry_msgs::Twist twist;
  twist.linear.x = linear;
  twist.angular.z = angular;
  const std::lock_guard lock(mutex_);
  if (!velocity_) return;
  velocity_.publish(twist);
  last_published_ = steady_clock::now();
}

void RosNode::Impl::run() {
  try {
    std::string said;
    auto next_tend = steady_clock::now();
    while (!ending_) {
      if (steady_clock::now() >= next_tend) {
        if (std::string state = tend(); state != said) {
          said = std::move(state);
          events_.on_state(said);
        }
        next_tend = steady_clock::now() + tend_period;
      }
      graph_.work();
    }
  } catch (const std::exception& e) {
    events_.on_failed(e.what());
  }
  leave_graph();
}

std::string RosNode::Impl::tend() {
  const std::string at = " the ROS master at " + master_.address().uri;
  const std::string problem = master_.unreachable();
  if (!problem.empty()) {
    announced_ = false;
    return graph_.has_joined() ? at.substr(1) + " is away (" + problem + "); what is connected goes on"
                               : "waits for" + at + ": " + problem;
  }
  if (!graph_.has_joined()) join_graph();
  const std::string& name = Graph::name();
  if (announced_) announced_ = master_.knows(name) == Master::Known::yes && hears_all();
  const bool images_ended = images_.end_if_silent();
  const bool odometry_ended = odometry_.end_if_silent();
  if (images_ended || odometry_ended) announced_ = false;
  if (!announced_) announced_ = announce();
  if (!announced_) return name + " is not yet registered with" + at;
  return name + " is registered with" + at + who_is_missing();
}

/// Called when the master answers for the first time.
void RosNode::Impl::join_graph() {
  graph_.join();
  if (topics_.velocity.empty()) return;
  const auto velocity = graph_.handle().advertise<geometry_msgs::Twist>(topics_.velocity, 1);
  const std::lock_guard lock(mutex_);
  velocity_ = velocity;
}

/// Tells the master this node's topics: at first, again after the master was away, and while nobody publishes a topic
/// that the node reads, because the answer lists the publishers.
bool RosNode::Impl::announce() {
  const auto hints = ::ros::TransportHints().tcpNoDelay();
  if (!images_.subscriber && !topics_.depth.empty()) {
    images_.set(graph_.handle().subscribe<sensor_msgs::Image>(
        topics_.depth, 1,
        [this](const sensor_msgs::ImageConstPtr& image) {
          images_.heard = steady_clock::now();
          events_.on_image(plain(*image));
        },
        {}, hints));
  }
  if (!odometry_.subscriber && !topics_.odometry.empty()) {
    odometry_.set(graph_.handle().subscribe<nav_msgs::Odometry>(
        topics_.odometry, 10,
        [this](const nav_msgs::OdometryConstPtr& where) {
          odometry_.heard = steady_clock::now();
          events_.on_odometry(plain(*where));
        },
        {}, hints));
  }
  const std::string& name = Graph::name();
  const std::string uri = Graph::uri();
  const auto read = [&](const ReadTopic& read_topic, const TopicRecord& topic) {
    return read_topic.subscriber && master_.register_subscriber(name, topic, uri);
  };
  bool done = true;
  if (!topics_.depth.empty()) done &= read(images_, record_of<sensor_msgs::Image>(images_.subscriber.getTopic()));
  if (!topics_.odometry.empty()) {
    done &= read(odometry_, record_of<nav_msgs::Odometry>(odometry_.subscriber.getTopic()));
  }
  if (!topics_.velocity.empty()) {
    done &= master_.register_publisher(name, record_of<geometry_msgs::Twist>(velocity_.getTopic()), uri);
  }
  return done;
}

bool RosNode::Impl::hears_all() const {
  const auto hears = [](const ReadTopic& topic) { return !topic.subscriber || topic.has_publishers(); };
  return hears(images_) && hears(odometry_);
}

std::string RosNode::Impl::who_is_missing() const {
  std::string missing;
  const auto nobody = [&](const char* what, const std::string& topic) { missing += "; " + (what + topic); };
  if (images_.subscriber && !images_.has_publishers()) {
    nobody("nobody publishes ", images_.subscriber.getTopic());
  } else if (images_.subscriber && steady_clock::now() - images_.heard > silence) {
    // roscpp goes on looking for a publisher that was killed.
    nobody("no image comes on ", images_.subscriber.getTopic());
  }
  if (odometry_.subscriber && !odometry_.has_publishers()) {
    nobody("nobody publishes ", odometry_.subscriber.getTopic());
  }
  if (velocity_ && velocity_.getNumSubscribers() == 0) nobody("nobody reads ", velocity_.getTopic());
  return missing;
}

void RosNode::Impl::leave_graph() {
  ::ros::Publisher velocity;
  steady_clock::time_point last;
  {
    const std::lock_guard lock(mutex_);
    velocity = std::exchange(velocity_, {});
    last = last_published_;
  }
  if (!graph_.has_joined()) return;
  // The last command stops the robot. roscpp passes it to the kernel soon, but does not say when.
  std::this_thread::sleep_until(last + flush_time);
  graph_.leave();
  images_ = {};
  odometry_ = {};
  velocity = {};
}

}  // namespace iotcloud::drivers::turtle::ros
