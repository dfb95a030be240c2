#include "iotcloud/brokers/rabbitmq/connections.h"

#include <algorithm>
#include <utility>

#include <pthread.h>

#include "iotcloud/brokers/rabbitmq/wire/socket.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

constexpr std::chrono::milliseconds keeper_period{250};

/// What a client says first; the server answers with what it can do. Under TLS that would take a handshake: there the
/// connection alone has to do.
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
  publishing_.push_back(std::make_unique<PublishLink>(cluster_, "publishing", meters_, clock_, log_));
  keeper_ = std::thread([this] { keep(); });
  pthread_setname_np(keeper_.native_handle(), "amqp-keeper");
}

Connections::~Connections() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  stop_.notify_all();
  keeper_.join();
  stop_reading();
}

void Connections::stop_reading() {
  ConsumeLinks links;
  {
    const std::lock_guard lock(mutex_);
    links = consuming_;
    links.insert(links.end(), urgent_.begin(), urgent_.end());
  }
  for (const auto& link : links) link->close();
}

PublishLink& Connections::publishing(std::uint8_t priority) {
  const std::lock_guard lock(mutex_);
  if (priority < urgent_priority) return *publishing_.front();
  if (publishing_.size() < 2) {
    publishing_.push_back(std::make_unique<PublishLink>(cluster_, "publishing urgent", meters_, clock_, log_));
  }
  return *publishing_.back();
}

ConsumeLink& Connections::roomy(ConsumeLinks& links) {
  const auto found = std::find_if(links.begin(), links.end(), [](const auto& link) { return link->has_room(); });
  if (found != links.end()) return **found;
  const char* purpose = &links == &urgent_ ? "consuming urgent" : "consuming";
  return *links.emplace_back(std::make_shared<ConsumeLink>(cluster_, purpose, meters_, clock_, log_));
}

std::shared_ptr<Inlet> Connections::subscribe(const Topic& topic, const SubscriptionOptions& options, Handler handler) {
  const std::lock_guard lock(mutex_);
  return roomy(links_for(options.priority)).add(topic, options, std::move(handler));
}

ConnectionState Connections::state() const {
  const std::lock_guard lock(mutex_);
  std::vector<ConnectionState> states;
  for (const auto& link : publishing_) states.push_back(link->state());
  for (const ConsumeLinks* links : {&urgent_, &consuming_}) {
    for (const auto& link : *links) states.push_back(link->state());
  }
  // The worst of all.
  for (const ConnectionState state : {ConnectionState::connecting, ConnectionState::blocked}) {
    if (std::find(states.begin(), states.end(), state) != states.end()) return state;
  }
  return ConnectionState::connected;
}

void Connections::keep() {
  std::unique_lock lock(mutex_);
  // By the system's clock: the other kind of wait is not known to the thread sanitizer.
  while (!stop_.wait_until(lock, std::chrono::system_clock::now() + keeper_period, [this] { return stopping_; })) {
    look_after();
    ask_preferred(lock);
  }
}

void Connections::look_after() {
  for (const auto& link : publishing_) link->watch();
  for (ConsumeLinks* links : {&urgent_, &consuming_}) {
    for (std::size_t i = 0; i < links->size(); ++i) {  // there may be more at the end
      const std::shared_ptr<ConsumeLink> link = (*links)[i];
      link->attend();
      // One is enough for a while: how many channels the server allows the new one is known when it is connected.
      if (link->crowded()) link->share(roomy(*links));
    }
  }
}

void Connections::ask_preferred(std::unique_lock<std::mutex>& lock) {
  if (cluster_.size() < 2) return;
  bool must_ask =
      std::any_of(publishing_.begin(), publishing_.end(), [](const auto& link) { return link->must_ask_preferred(); });
  for (const ConsumeLinks* links : {&urgent_, &consuming_}) {
    must_ask = must_ask ||
               std::any_of(links->begin(), links->end(), [](const auto& link) { return link->must_ask_preferred(); });
  }
  lock.unlock();  // the name's resolution may take long
  if (must_ask && !probe_.under_way()) probe_.start();
  const std::optional<bool> answer = probe_.poll();
  lock.lock();
  if (!answer) return;
  for (const auto& link : publishing_) link->preferred_answered(*answer);
  for (const ConsumeLinks* links : {&urgent_, &consuming_}) {
    for (const auto& link : *links) link->preferred_answered(*answer);
  }
}

}  // namespace iotcloud::brokers::rabbitmq
