#include "iotcloud/brokers/embedded/connection.h"

#include <algorithm>
#include <exception>
#include <utility>

#include <pthread.h>

#include <iotcloud/config/log.h>

namespace iotcloud::brokers::embedded {
namespace {

const config::Logger logger{"brokers.embedded"};

}  // namespace

HandlerConsumer::HandlerConsumer(std::shared_ptr<ServerState> server, std::shared_ptr<EmbeddedConnection> owner,
                                 Handler handler_to_run)
    : handler(std::move(handler_to_run)), server_(std::move(server)), owner_(std::move(owner)) {}

void HandlerConsumer::settle(std::uint64_t tag, Settlement settlement) noexcept {
  WakeList wake;
  const config::MutexLock lock(server_->mutex);
  const auto found = unsettled.find(tag);
  if (found == unsettled.end()) return;  // the server was stopped meanwhile, or the subscription was closed
  if (settlement == Settlement::retry && queue) queue->put_back(std::move(found->second));
  unsettled.erase(found);
  if (queue) server_->make_ready(*queue, wake);
}

EmbeddedConnection::EmbeddedConnection(std::shared_ptr<ServerState> of, const config::Clock& time, Meters counters)
    : server(std::move(of)), clock(time), meters(std::move(counters)) {}

void EmbeddedConnection::open() {
  {
    const config::MutexLock lock(server->mutex);
    server->join(*this);
  }
  thread_ = std::thread([this] { run(); });
  pthread_setname_np(thread_.native_handle(), "embedded-reader");
}

void EmbeddedConnection::close() {
  {
    const config::MutexLock lock(server->mutex);
    closing_ = true;
  }
  wake();
  thread_.join();
  const config::MutexLock lock(server->mutex);
  server->leave(*this);
  // Readers own their connection, so the lists must let go of them, or neither would be destroyed.
  ready.clear();
  to_report.clear();
}

void EmbeddedConnection::wake() {
  {
    const config::MutexLock lock(sleep_mutex_);
    woken_ = true;
  }
  sleep_over_.notify_one();
}

void EmbeddedConnection::sleep(std::optional<Instant> until) {
  const config::MutexLock lock(sleep_mutex_);
  const auto over = [this]() IOTCLOUD_REQUIRES(sleep_mutex_) { return woken_; };
  if (until) {
    sleep_over_.wait_until(sleep_mutex_, clock, *until, over);
  } else {
    sleep_over_.wait(sleep_mutex_, over);
  }
  woken_ = false;
}

std::optional<Instant> EmbeddedConnection::next_deadline(Instant now) {
  std::optional<Instant> next;
  for (ServerPublisher* publisher : timed) {
    WakeList unneeded;  // expire() wants one; this thread is awake already
    server->expire(*publisher, now, unneeded);
    publisher->timed = !publisher->waiting.empty();
    if (!publisher->timed) continue;
    const Instant expires = publisher->waiting.front().accepted + publisher->options.deadline;
    if (!next || expires < *next) next = expires;
  }
  std::erase_if(timed, [](const ServerPublisher* publisher) { return !publisher->timed; });
  return next;
}

void EmbeddedConnection::run() {
  config::UniqueLock lock(server->mutex);
  while (!closing_) {
    if (deliver_next()) continue;
    const std::optional<Instant> deadline = next_deadline(clock.now());
    if (!to_report.empty()) {
      const std::shared_ptr<ServerPublisher> publisher = to_report.front();
      report(publisher);
      continue;
    }
    sleeping = true;
    lock.unlock();
    sleep(deadline);
    lock.lock();
    sleeping = false;
  }
}

bool EmbeddedConnection::deliver_next() {
  if (ready.empty()) return false;
  const std::shared_ptr<HandlerConsumer> reader = std::static_pointer_cast<HandlerConsumer>(std::move(ready.front()));
  ready.pop_front();
  reader->in_ready = false;
  if (!reader->can_take()) return true;
  std::optional<StoredMessage> stored;
  std::size_t conflated = 0;
  {
    WakeList wake;
    stored = server->take(*reader, clock.now(), wake, conflated);
    // `wake` wakes threads while the lock is held, but it has some only if the queue was full.
  }
  for (; conflated > 0; --conflated) meters.conflated();
  if (!stored) return true;
  meters.received(stored->redelivered);
  ++stored->tries;
  const std::uint64_t tag = ++reader->last_tag;
  if (!reader->options.automatic_ack) reader->unsettled.emplace(tag, *stored);
  {
    WakeList unneeded;
    server->make_ready(reader, unneeded);  // puts it behind this connection's other consumers in `ready`
  }
  reader->running = true;
  {
    const config::Unlocked unlocked(server->mutex);
    run_handler(reader, std::move(*stored), tag);
  }
  reader->running = false;
  if (reader->closed) changed.notify_all();
  return true;
}

void EmbeddedConnection::run_handler(const std::shared_ptr<HandlerConsumer>& reader, StoredMessage stored,
                                     std::uint64_t tag) {
  std::shared_ptr<Settler> settler;
  if (!reader->options.automatic_ack) settler = reader;
  try {
    Delivery delivery(std::move(stored.message), stored.redelivered, std::move(settler), tag);
    delivery.tries = stored.tries;
    reader->handler(std::move(delivery));
  } catch (const std::exception& error) {
    logger.error("the handler of topic {} threw: {}; the message is delivered again", reader->topic.name, error.what());
  } catch (...) {
    logger.error("the handler of topic {} threw; the message is delivered again", reader->topic.name);
  }
}

void EmbeddedConnection::call_back(const ServerPublisher& publisher, const std::vector<ServerPublisher::Event>& events,
                                   bool writable) {
  try {
    for (const auto& event : events) publisher.options.on_outcome(event.number, event.outcome, event.reason);
    if (writable && publisher.options.on_writable) publisher.options.on_writable();
  } catch (const std::exception& error) {
    logger.error("a callback of the publisher of topic {} threw: {}", publisher.topic.name, error.what());
  } catch (...) {
    logger.error("a callback of the publisher of topic {} threw", publisher.topic.name);
  }
}

void EmbeddedConnection::report(const std::shared_ptr<ServerPublisher>& publisher) {
  while (publisher->reporting) changed.wait(server->mutex);
  if (std::exchange(publisher->in_report, false)) std::erase(to_report, publisher);
  const std::vector<ServerPublisher::Event> events = std::exchange(publisher->events, {});
  const bool writable = std::exchange(publisher->writable_due, false);
  if (events.empty() && !writable) return;
  publisher->reporting = true;
  {
    const config::Unlocked unlocked(server->mutex);
    call_back(*publisher, events, writable);
  }
  publisher->reporting = false;
  publisher->pending -= events.size();
  changed.notify_all();
}

}  // namespace iotcloud::brokers::embedded
