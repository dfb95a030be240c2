#include "iotcloud/brokers/embedded/server.h"

#include <algorithm>

#include "iotcloud/brokers/embedded/connection.h"
#include "iotcloud/brokers/embedded/server_state.h"

namespace iotcloud::brokers::embedded {

WakeList::~WakeList() {
  if (first_) first_->wake();
  for (const auto& connection : others_) connection->wake();
}

void WakeList::add(EmbeddedConnection& connection) {
  connection.assert_held();
  if (!connection.sleeping) return;
  connection.sleeping = false;
  if (!first_) {
    first_ = connection.shared_from_this();
  } else {
    others_.push_back(connection.shared_from_this());
  }
}

std::string queue_name(const std::string& topic, const std::string& group) {
  return group.empty() ? topic : topic + "." + group;
}

std::shared_ptr<Route> ServerState::route(const std::string& topic) {
  auto& route = routes_[topic];
  if (!route) route = std::make_shared<Route>();
  return route;
}

const Queue* ServerState::find(const std::string& queue_name) const {
  const auto found = queues_.find(queue_name);
  return found == queues_.end() ? nullptr : found->second.get();
}

void ServerState::stop(WakeList& wake) {
  if (!running_) return;
  running_ = false;
  for (EmbeddedConnection* connection : connections_) {
    connection->assert_held();
    for (const auto& consumer : connection->consumers) {
      if (!consumer->queue) continue;
      consumer->queue->detach(*consumer, connection->clock.now());
      consumer->queue = nullptr;
    }
    wake.add(*connection);
  }
  std::erase_if(queues_, [](const auto& entry) { return !entry.second->durable(); });
  for (const auto& [topic, route] : routes_) {
    std::erase_if(route->queues, [](const auto& queue) { return !queue->durable(); });
  }
}

void ServerState::start(WakeList& wake) {
  if (running_) return;
  running_ = true;
  for (EmbeddedConnection* connection : connections_) {
    connection->assert_held();
    for (const auto& consumer : connection->consumers) attach(consumer, connection->clock.now(), wake);
  }
  for (EmbeddedConnection* connection : connections_) {
    connection->assert_held();
    for (ServerPublisher* publisher : connection->publishers) {
      if (publisher->options.own_queue) make_own_queue(publisher->topic, connection->clock.now());
      flush(*publisher, connection->clock.now(), wake);
    }
  }
}

void ServerState::remove_idle(Route& route, Instant now) {
  std::erase_if(route.queues, [&](const std::shared_ptr<Queue>& queue) {
    mutex.assert_held();
    const bool idle = !queue->durable() && !queue->has_readers() && now - queue->unused_since() > idle_queue_limit;
    if (idle) queues_.erase(queue->name());
    return idle;
  });
}

void ServerState::sweep(Instant now) {
  if (now - last_sweep_ < idle_queue_limit) return;
  last_sweep_ = now;
  std::erase_if(routes_, [&](const auto& entry) {
    mutex.assert_held();
    remove_idle(*entry.second, now);
    return entry.second->queues.empty() && entry.second.use_count() == 1;  // no publisher holds it
  });
}

bool ServerState::deliver(Route& route, ServerPublisher::Waiting& waiting, const PublisherOptions& options, Instant now,
                          WakeList& wake) {
  if (!running_) return false;
  remove_idle(route, now);
  if (route.queues.empty()) return false;
  for (const auto& queue : route.queues) {
    if (queue->bytes() > queue_bytes_limit) return false;
  }
  std::optional<Instant> expires;
  if (options.deadline.count() > 0) expires = waiting.accepted + options.deadline;
  for (std::size_t i = 0; i + 1 < route.queues.size(); ++i)
    route.queues[i]->push(waiting.message, expires, waiting.old);
  route.queues.back()->push(std::move(waiting.message), expires, waiting.old);
  for (const auto& queue : route.queues) make_ready(*queue, wake);
  return true;
}

void ServerState::expire(ServerPublisher& publisher, Instant now, WakeList& wake) {
  if (publisher.options.void_before) {
    const Instant void_before = publisher.options.void_before();
    while (!publisher.waiting.empty() && publisher.waiting.front().accepted < void_before) {
      settle(publisher, publisher.waiting.front().number, Outcome::dropped, reason::fenced, wake);
      publisher.waiting.pop_front();
    }
  }
  if (publisher.options.deadline.count() <= 0) return;
  while (!publisher.waiting.empty() && publisher.waiting.front().accepted + publisher.options.deadline <= now) {
    settle(publisher, publisher.waiting.front().number, Outcome::dropped, reason::deadline, wake);
    publisher.waiting.pop_front();
  }
}

void ServerState::flush(ServerPublisher& publisher, Instant now, WakeList& wake) {
  expire(publisher, now, wake);
  while (!publisher.waiting.empty()) {
    auto& first = publisher.waiting.front();
    if (!deliver(*publisher.route, first, publisher.options, now, wake)) break;
    settle(publisher, first.number, Outcome::confirmed, "", wake);
    publisher.waiting.pop_front();
  }
  if (publisher.waiting.empty()) std::erase(publisher.route->waiting, &publisher);
}

void ServerState::settle(ServerPublisher& publisher, std::uint64_t number, Outcome outcome, const char* reason,
                         WakeList& wake) {
  if (publisher.wants_writable && !publisher.closed) {
    publisher.wants_writable = false;
    publisher.writable_due = true;
  }
  publisher.connection->meters.outcome(outcome, reason);
  if (publisher.options.on_outcome) {
    publisher.events.push_back({number, outcome, reason});
  } else {
    --publisher.pending;
    if (publisher.pending == 0) publisher.connection->changed.notify_all();
    if (!publisher.writable_due) return;
  }
  if (!publisher.in_report) {
    publisher.in_report = true;
    publisher.connection->assert_held();
    publisher.connection->to_report.push_back(publisher.shared_from_this());
  }
  wake.add(*publisher.connection);
}

void ServerState::flush_waiting(Route& route, Instant now, WakeList& wake) {
  const std::vector<ServerPublisher*> waiting =
      route.waiting;  // a copy, because flush() removes publishers that are done
  for (ServerPublisher* publisher : waiting) flush(*publisher, now, wake);
}

void ServerState::flush_topics_of(const Queue& queue, Instant now, WakeList& wake) {
  for (const auto& [topic, route] : routes_) {
    const bool bound = std::any_of(route->queues.begin(), route->queues.end(),
                                   [&](const auto& candidate) { return candidate.get() == &queue; });
    if (bound && !route->waiting.empty()) flush_waiting(*route, now, wake);
  }
}

/// Makes the queue if it does not exist, and binds it to the topic.
std::shared_ptr<Queue> ServerState::bound_queue(const std::string& name, const Topic& topic, Instant now) {
  auto& queue = queues_[name];
  if (!queue) queue = std::make_shared<Queue>(name, topic.durable, now);
  auto& bound = route(topic.name)->queues;
  if (std::find(bound.begin(), bound.end(), queue) == bound.end()) bound.push_back(queue);
  return queue;
}

void ServerState::make_own_queue(const Topic& topic, Instant now) {
  if (running_) bound_queue(topic.name, topic, now);
}

void ServerState::attach(const std::shared_ptr<Consumer>& consumer, Instant now, WakeList& wake) {
  if (!running_ || consumer->closed || consumer->queue) return;
  sweep(now);
  consumer->queue = bound_queue(queue_name(consumer->topic.name, consumer->options.group), consumer->topic, now);
  consumer->queue->attach(consumer);
  make_ready(consumer, wake);
  flush_waiting(*route(consumer->topic.name), now, wake);
}

void ServerState::remove_unneeded(const std::string& queue_name) {
  const auto found = queues_.find(queue_name);
  if (found == queues_.end()) return;
  const std::shared_ptr<Queue> queue = found->second;
  if (queue->has_readers() || queue->size() + queue->unsettled() > 0) return;
  for (const auto& [topic, route] : routes_) std::erase(route->queues, queue);
  queues_.erase(found);
}

void ServerState::detach(Consumer& consumer, Instant now, WakeList& wake) {
  if (!consumer.queue) return;
  const std::shared_ptr<Queue> queue = std::exchange(consumer.queue, nullptr);
  queue->detach(consumer, now);
  make_ready(*queue, wake);
}

std::optional<StoredMessage> ServerState::take(Consumer& consumer, Instant now, WakeList& wake,
                                               std::size_t& conflated) {
  Queue& queue = *consumer.queue;
  const bool was_full = queue.bytes() > queue_bytes_limit;
  if (consumer.options.keep_last > 0) conflated = queue.trim(consumer.options.keep_last);
  std::optional<StoredMessage> taken = queue.pop(now);
  if (was_full && queue.bytes() <= queue_bytes_limit) flush_topics_of(queue, now, wake);
  return taken;
}

void ServerState::make_ready(Queue& queue, WakeList& wake) {
  for (const auto& reader : queue.readers()) make_ready(reader, wake);
}

void ServerState::make_ready(const std::shared_ptr<Consumer>& consumer, WakeList& wake) {
  if (consumer->in_ready || !consumer->can_take()) return;
  consumer->in_ready = true;
  consumer->connection->assert_held();
  consumer->connection->ready.push_back(consumer);
  wake.add(*consumer->connection);
}

Server Server::named(const std::string& name) {
  static config::Mutex mutex;
  static std::map<std::string, std::weak_ptr<ServerState>> servers;
  const config::MutexLock lock(mutex);
  std::erase_if(servers, [](const auto& entry) { return entry.second.expired(); });
  auto& known = servers[name];
  std::shared_ptr<ServerState> state = known.lock();
  if (!state) known = state = std::make_shared<ServerState>();
  return Server(std::move(state));
}

void Server::stop() {
  WakeList wake;  // declared before the lock, so that it wakes threads after the lock is released
  const config::MutexLock lock(state_->mutex);
  state_->stop(wake);
}

void Server::start() {
  WakeList wake;
  const config::MutexLock lock(state_->mutex);
  state_->start(wake);
}

bool Server::running() const {
  const config::MutexLock lock(state_->mutex);
  return state_->running();
}

bool Server::has_queue(const std::string& topic, const std::string& group) const {
  const config::MutexLock lock(state_->mutex);
  return state_->find(queue_name(topic, group)) != nullptr;
}

std::size_t Server::depth(const std::string& topic, const std::string& group) const {
  const config::MutexLock lock(state_->mutex);
  const Queue* queue = state_->find(queue_name(topic, group));
  return queue == nullptr ? 0 : queue->size() + queue->unsettled();
}

}  // namespace iotcloud::brokers::embedded
