#include "iotcloud/brokers/rabbitmq/connections.h"

#include <algorithm>
#include <utility>

#include <pthread.h>

#include "iotcloud/brokers/rabbitmq/wire/socket.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

constexpr std::chrono::milliseconds keeper_period{250};

/// The first bytes of a client, which the server answers. Empty under TLS, which would need a handshake first: there an
/// open TCP connection counts as an answer.
std::string greeting_for(const BrokerUrl& url) {
  using namespace std::string_literals;
  return url.scheme == "amqps" ? "" : "AMQP\0\0\x09\x01"s;
}

}  // namespace

Connections::Connections(const Cluster& cluster, Meters& meters, const config::Clock& clock)
    : cluster_(cluster),
      meters_(meters),
      clock_(clock),
      log_(cluster.name(0)),
      probe_(cluster.url(0).host, static_cast<std::uint16_t>(port_of(cluster.url(0))), greeting_for(cluster.url(0)),
             clock) {
  publishing_.push_back(std::make_unique<PublishChannel>(cluster_, "publishing", meters_, clock_, log_));
  keeper_ = std::thread([this] { keep(); });
  pthread_setname_np(keeper_.native_handle(), "amqp-keeper");
}

Connections::~Connections() {
  {
    const config::MutexLock lock(mutex_);
    stopping_ = true;
  }
  stop_.notify_all();
  keeper_.join();
  stop_reading();
}

void Connections::stop_reading() {
  ReadConnections links;
  {
    const config::MutexLock lock(mutex_);
    links = consuming_;
    links.insert(links.end(), urgent_.begin(), urgent_.end());
  }
  for (const auto& link : links) link->close();
}

PublishChannel& Connections::publishing(std::uint8_t priority) {
  const config::MutexLock lock(mutex_);
  if (priority < urgent_priority) return *publishing_.front();
  if (publishing_.size() < 2) {
    publishing_.push_back(std::make_unique<PublishChannel>(cluster_, "publishing urgent", meters_, clock_, log_));
  }
  return *publishing_.back();
}

std::shared_ptr<ReadConnection> Connections::with_room(std::uint8_t priority) {
  ReadConnections& links = links_for(priority);
  const auto found = std::find_if(links.begin(), links.end(), [](const auto& link) { return link->has_room(); });
  if (found != links.end()) return *found;
  const char* purpose = priority >= urgent_priority ? "consuming urgent" : "consuming";
  return links.emplace_back(std::make_shared<ReadConnection>(cluster_, purpose, meters_, clock_, log_));
}

std::shared_ptr<QueueReader> Connections::subscribe(const Topic& topic, const SubscriptionOptions& options,
                                                    Handler handler) {
  const config::MutexLock lock(mutex_);
  return with_room(options.priority)->add(topic, options, std::move(handler));
}

ConnectionState Connections::state() const {
  const config::MutexLock lock(mutex_);
  std::vector<ConnectionState> states;
  for (const auto& link : publishing_) states.push_back(link->state());
  for (const ReadConnections* links : {&urgent_, &consuming_}) {
    for (const auto& link : *links) states.push_back(link->state());
  }
  // The state of the worst connection.
  for (const ConnectionState state : {ConnectionState::connecting, ConnectionState::blocked}) {
    if (std::find(states.begin(), states.end(), state) != states.end()) return state;
  }
  return ConnectionState::connected;
}

Connections::Links Connections::links() const {
  Links links{{}, consuming_, urgent_};
  for (const auto& channel : publishing_) links.publishing.push_back(channel.get());
  return links;
}

void Connections::keep() {
  const config::MutexLock lock(mutex_);
  const auto stopping = [this]() IOTCLOUD_REQUIRES(mutex_) { return stopping_; };
  while (!stop_.wait_until(mutex_, clock_, clock_.now() + keeper_period, stopping)) {
    const Links now = links();
    // look_after() locks links' mutexes, uses sockets and resolves names, which may take long.
    const config::Unlocked unlocked(mutex_);
    look_after(now);
    ask_preferred(now);
  }
}

void Connections::look_after(const Links& links) {
  for (PublishChannel* const channel : links.publishing) {
    channel->watch();
    channel->life().check_server();
  }
  const auto attend = [this](const ReadConnections& reading, std::uint8_t priority) {
    for (const auto& link : reading) {
      link->read_during_handler();
      link->life().check_server();
      if (!link->over_limit()) continue;
      // One new connection at a time: the server tells it only after connecting how many channels it allows.
      std::shared_ptr<ReadConnection> other;
      {
        const config::MutexLock lock(mutex_);
        other = with_room(priority);
      }
      link->share(*other);
    }
  };
  attend(links.urgent, urgent_priority);
  attend(links.consuming, normal_priority);
}

void Connections::ask_preferred(const Links& links) {
  if (cluster_.size() < 2) return;
  const auto for_each = [&](const auto& what) {
    for (PublishChannel* const channel : links.publishing) what(*channel);
    for (const auto& link : links.urgent) what(*link);
    for (const auto& link : links.consuming) what(*link);
  };
  bool must_ask = false;
  for_each([&](auto& link) { must_ask = must_ask || link.life().must_ask_preferred(); });
  if (must_ask && !probe_.under_way()) probe_.start();
  const std::optional<bool> answer = probe_.poll();
  if (!answer) return;
  for_each([&](auto& link) { link.life().preferred_answered(*answer); });
}

}  // namespace iotcloud::brokers::rabbitmq
