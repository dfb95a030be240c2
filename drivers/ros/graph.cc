#include <atomic>
#include <chrono>
#include <stdexcept>
#include <string>

#include <ros/init.h>
#include <ros/master.h>
#include <ros/this_node.h>
#include <ros/xmlrpc_manager.h>

#include <iotcloud/drivers/ros/graph.h>

namespace ros::master {
/// ros::init() calls this, but only the first time in a process: it sets the master's address.
void init(const M_string& remappings);
}  // namespace ros::master

namespace iotcloud::drivers::ros {

namespace {

constexpr double wait_s = 0.1;                          // for messages; the node's end is noticed within this time
constexpr const char* nowhere = "http://127.0.0.1:1/";  // refuses connections at once
std::atomic<bool> taken = false;                        // this process has a node

}  // namespace

Graph::Graph(const Master& master, const char* name, const char* plugin) : master_(master) {
  if (taken.exchange(true)) {
    throw std::runtime_error(
        "this process has a ROS node already, and roscpp allows one to a process: deploy each instance with "
        "isolation=instance (or without the property: it is what " +
        std::string(plugin) + " asks for)");
  }
  try {
    const ::ros::M_string settings{
        {"__master", master_.address().uri}, {"__log", "/dev/null"},  // otherwise it makes folders in the user's home
    };
    ::ros::init(
        settings, name,
        ::ros::init_options::NoSigintHandler | ::ros::init_options::AnonymousName | ::ros::init_options::NoRosout);
    ::ros::master::init(settings);
    const ::ros::WallDuration limit(std::chrono::duration<double>(master_.limit()).count());
    ::ros::master::setRetryTimeout(limit);
  } catch (...) {
    taken = false;
    throw;
  }
}

Graph::~Graph() {
  handle_.reset();
  taken = false;
}

void Graph::join() {
  ::ros::start();
  handle_ = std::make_unique<::ros::NodeHandle>();
  handle_->setCallbackQueue(&queue_);
}

void Graph::work() {
  queue_.callAvailable(::ros::WallDuration(wait_s));
  if (handle_ && !::ros::ok()) throw std::runtime_error("the ROS node was told to shut down (rosnode kill)");
}

const std::string& Graph::name() {
  return ::ros::this_node::getName();
}

std::string Graph::uri() {
  return ::ros::XMLRPCManager::instance()->getServerURI();
}

void Graph::leave() {
  if (!handle_) return;
  // roscpp's farewell calls have no time limit: if the master does not answer, send them to an address that refuses.
  if (!master_.unreachable().empty()) ::ros::master::init({{"__master", nowhere}});
  ::ros::shutdown();
}

}  // namespace iotcloud::drivers::ros
