#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <vector>

#include <netdb.h>
#include <poll.h>
#include <ros/names.h>
#include <sys/socket.h>
#include <unistd.h>
#include <xmlrpcpp/XmlRpcClient.h>
#include <xmlrpcpp/XmlRpcException.h>
#include <xmlrpcpp/XmlRpcValue.h>

#include <iotcloud/drivers/ros/master.h>

namespace iotcloud::drivers::ros {

namespace {

using std::chrono::steady_clock;
using XmlRpc::XmlRpcValue;

/// The master's answer: a status (1 is success), a text for people and a value.
struct Answer {
  int status = 0;
  XmlRpcValue value;
};

std::optional<Answer> as_answer(XmlRpcValue& result) {
  if (result.getType() != XmlRpcValue::TypeArray || result.size() != 3) return std::nullopt;
  if (result[0].getType() != XmlRpcValue::TypeInt) return std::nullopt;
  return Answer{static_cast<int>(result[0]), result[2]};
}

XmlRpcValue list_of(const std::vector<std::string>& words) {
  XmlRpcValue list;
  list.setSize(static_cast<int>(words.size()));
  for (std::size_t i = 0; i < words.size(); ++i) list[static_cast<int>(i)] = words[i];
  return list;
}

std::optional<Answer> call(const MasterAddress& address, std::chrono::milliseconds limit, const char* method,
                           const XmlRpcValue& arguments) {
  try {
    XmlRpcValue result;
    XmlRpc::XmlRpcClient client(address.host.c_str(), address.port, "/");
    if (!client.executeNonBlock(method, arguments)) return std::nullopt;
    const auto deadline = steady_clock::now() + limit;
    const std::chrono::duration<double> all = limit;
    client._disp.work(all.count());  // returns earlier when the call is done
    if (steady_clock::now() >= deadline || !client.executeCheckDone(result)) return std::nullopt;
    return as_answer(result);
  } catch (const XmlRpc::XmlRpcException&) {  // the answer's types differ from what it declares
    return std::nullopt;
  }
}

/// Tries to connect. \return why there was no connection within `limit`; empty if there was one.
std::string try_connection(const addrinfo& to, std::chrono::milliseconds limit) {
  const int descriptor = socket(to.ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (descriptor < 0) return std::strerror(errno);
  const auto close_it = [](const int* open) { close(*open); };
  const std::unique_ptr<const int, decltype(close_it)> closed_at_the_end(&descriptor, close_it);
  if (connect(descriptor, to.ai_addr, to.ai_addrlen) == 0) return {};
  if (errno != EINPROGRESS) return std::strerror(errno);
  pollfd waiting{descriptor, POLLOUT, 0};
  if (poll(&waiting, 1, static_cast<int>(limit.count())) <= 0) return "no connection within the time limit";
  int error = 0;
  socklen_t size = sizeof error;
  getsockopt(descriptor, SOL_SOCKET, SO_ERROR, &error, &size);
  return error == 0 ? "" : std::strerror(error);
}

}  // namespace

MasterAddress parse_master_address(const std::string& uri) {
  constexpr std::string_view scheme = "http://";
  MasterAddress address{uri, {}, 0};
  std::string_view rest = uri;
  if (rest.substr(0, scheme.size()) == scheme) {
    rest.remove_prefix(scheme.size());
    if (!rest.empty() && rest.back() == '/') rest.remove_suffix(1);
    const auto colon = rest.rfind(':');
    if (colon != std::string_view::npos && colon > 0) {
      const std::string_view port = rest.substr(colon + 1);
      const auto [end, status] = std::from_chars(port.data(), port.data() + port.size(), address.port);
      if (status == std::errc{} && end == port.data() + port.size() && address.port > 0 && address.port < 65536) {
        address.host = rest.substr(0, colon);
        return address;
      }
    }
  }
  throw std::invalid_argument("property \"ros_master\" (or ROS_MASTER_URI in the gateway's environment) is \"" + uri +
                              "\"; it takes the ROS master's address, as in http://localhost:11311");
}

std::string default_master() {
  const char* uri = std::getenv("ROS_MASTER_URI");
  return uri != nullptr && *uri != '\0' ? uri : "http://localhost:11311";
}

std::string problem_of_topic(const std::string& name) {
  std::string problem;
  ::ros::names::validate(name, problem);
  return problem;
}

std::string Master::unreachable() const {
  addrinfo hints{};
  hints.ai_family = AF_INET;  // as roscpp does
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const int status = getaddrinfo(address_.host.c_str(), std::to_string(address_.port).c_str(), &hints, &found);
  if (status != 0) return "its host \"" + address_.host + "\" is not known: " + gai_strerror(status);
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> addresses(found, &freeaddrinfo);
  if (std::string reason = try_connection(*addresses, limit_); !reason.empty()) return reason;
  // A connection alone proves little: the kernel accepts one for a master that hangs.
  const auto answer = call(address_, limit_, "getPid", list_of({"/iotcloud"}));
  return answer && answer->status == 1 ? "" : "it does not answer";
}

Master::Known Master::knows(const std::string& node) const {
  const auto answer = call(address_, limit_, "lookupNode", list_of({node, node}));
  if (!answer) return Known::no_answer;
  return answer->status == 1 ? Known::yes : Known::no;
}

bool Master::register_publisher(const std::string& node, const TopicRecord& topic, const std::string& node_uri) const {
  const auto answer = call(address_, limit_, "registerPublisher", list_of({node, topic.topic, topic.type, node_uri}));
  return answer && answer->status == 1;
}

bool Master::register_subscriber(const std::string& node, const TopicRecord& topic, const std::string& node_uri) const {
  auto answer = call(address_, limit_, "registerSubscriber", list_of({node, topic.topic, topic.type, node_uri}));
  if (!answer || answer->status != 1 || answer->value.getType() != XmlRpcValue::TypeArray) return false;
  // A publisher that this master does not know may still be connected: keep it until there is another.
  if (answer->value.size() == 0) return true;
  XmlRpcValue update = list_of({"/master", topic.topic});
  update[2] = answer->value;
  MasterAddress node_address = parse_master_address(node_uri);
  node_address.host = "127.0.0.1";  // this very process; others may look up its name, this machine perhaps not
  const auto taken = call(node_address, limit_, "publisherUpdate", update);
  return taken && taken->status == 1;
}

std::vector<std::string> Master::publishers_of(const std::string& node, const TopicRecord& topic,
                                               const std::string& node_uri) const {
  auto answer = call(address_, limit_, "registerSubscriber", list_of({node, topic.topic, topic.type, node_uri}));
  std::vector<std::string> uris;
  if (!answer || answer->status != 1 || answer->value.getType() != XmlRpcValue::TypeArray) return uris;
  for (int i = 0; i < answer->value.size(); ++i) {
    if (answer->value[i].getType() == XmlRpcValue::TypeString)
      uris.push_back(static_cast<std::string>(answer->value[i]));
  }
  return uris;
}

std::optional<int> Master::process_at(const std::string& node_uri) const {
  try {
    auto answer = call(parse_master_address(node_uri), limit_, "getPid", list_of({"/iotcloud"}));
    if (!answer || answer->status != 1 || answer->value.getType() != XmlRpcValue::TypeInt) return std::nullopt;
    return static_cast<int>(answer->value);
  } catch (const std::invalid_argument&) {  // another node said that this is its address
    return std::nullopt;
  }
}

}  // namespace iotcloud::drivers::ros
