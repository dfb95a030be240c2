#include "iotcloud/brokers/rabbitmq/connection_life.h"

#include <algorithm>
#include <utility>

#include <pthread.h>

#include <iotcloud/brokers/rabbitmq/logger.h>

namespace iotcloud::brokers::rabbitmq {

ConnectionLife::ConnectionLife(const char* name, Owner& owner, config::Mutex& mutex, ConnectionSleep& sleep,
                               const Cluster& cluster, const config::Clock& clock, ConnectionLog& log)
    : name_(name),
      owner_(owner),
      mutex_(mutex),
      sleep_(sleep),
      cluster_(cluster),
      clock_(clock),
      log_(log),
      servers_(cluster.size()) {}

void ConnectionLife::start() {
  mutex_.assert_held();
  if (ending_) return;
  if (std::exchange(started_, true)) return wake();
  thread_ = std::thread([this] { run(); });
  pthread_setname_np(thread_.native_handle(), name_);
}

bool ConnectionLife::begin_to_end() {
  mutex_.assert_held();
  return !std::exchange(ending_, true) && started_;
}

void ConnectionLife::join() {
  sleep_.signal();
  thread_.join();
}

void ConnectionLife::wake() noexcept {
  mutex_.assert_held();
  if (std::exchange(sleeping_, false)) sleep_.signal();
}

void ConnectionLife::broke() noexcept {
  mutex_.assert_held();
  broken_ = std::current_exception();
  wake();
}

void ConnectionLife::check_server() {
  const config::MutexLock lock(mutex_);
  const std::shared_ptr<ShownChain> shown = shown_;
  if (!shown) return;
  std::string why;
  {
    const config::Unlocked unlocked(mutex_);
    why = cluster_.trust().distrust(*shown, clock_.now());
  }
  if (why.empty() || shown != shown_ || broken_) return;
  broken_ = std::make_exception_ptr(LinkError(why));
  wake();
}

bool ConnectionLife::started() const {
  mutex_.assert_held();
  return started_;
}

bool ConnectionLife::ending() const {
  mutex_.assert_held();
  return ending_;
}

bool ConnectionLife::broken() const {
  mutex_.assert_held();
  return broken_ != nullptr;
}

bool ConnectionLife::sleeps() const {
  mutex_.assert_held();
  return sleeping_;
}

bool ConnectionLife::moving() const {
  mutex_.assert_held();
  return moving_since_.has_value();
}

bool ConnectionLife::must_ask_preferred() const {
  const config::MutexLock lock(mutex_);
  return servers_.must_ask(clock_.now());
}

void ConnectionLife::preferred_answered(bool answers) {
  const config::MutexLock lock(mutex_);
  servers_.asked(answers, clock_.now());
  if (servers_.must_move_back(clock_.now())) wake();
}

void ConnectionLife::run() {
  const config::MutexLock lock(mutex_);
  while (!ending_) {
    try {
      round();
    } catch (const std::exception& error) {  // LinkError, or memory that ran out: both end this connection
      lose(error.what());
    }
    if (!ending_) sleep();
  }
  if (open_) end();
}

void ConnectionLife::round() {
  if (!open_) connect();
  if (open_ && !ending_) {
    if (broken_) std::rethrow_exception(broken_);
    owner_.serve(ready_);
  }
  owner_.call_back();
  if (open_ && !broken_) move_back();
}

void ConnectionLife::connect() {
  const std::optional<std::size_t> server = servers_.due(clock_.now());
  if (!server) return;
  std::optional<std::string> problem;
  {
    const config::Unlocked unlocked(mutex_);
    try {
      owner_.open(*server);
    } catch (const std::exception& error) {  // LinkError, or memory that ran out
      problem = error.what();
    }
    if (problem) {
      log_.failed(cluster_.name(*server), *problem);
    } else {
      log_.connected(cluster_.name(*server));
    }
  }
  if (problem) return servers_.failed(*server, clock_.now());
  servers_.connected(*server, clock_.now());
  open_ = true;
  shown_ = owner_.opened();
}

void ConnectionLife::part(bool in_order) {
  // Other threads may use the connection until forget() has it alone, and may find it broken until then.
  owner_.forget();
  open_ = false;
  broken_ = nullptr;
  shown_ = nullptr;
  moving_since_.reset();
  const config::Unlocked unlocked(mutex_);
  owner_.close(in_order);
}

void ConnectionLife::lose(const std::string& reason) {
  if (servers_.current()) log_.lost(cluster_.name(*servers_.current()), reason);
  servers_.lost(clock_.now());
  if (open_) part(false);
}

void ConnectionLife::move_back() {
  const Instant now = clock_.now();
  if (!moving_since_) {
    if (!servers_.must_move_back(now)) return;
    moving_since_ = now;
  }
  if (!owner_.idle() && now - *moving_since_ < moving_patience) return;
  logger.info("{} answers again: going back to it", cluster_.name(client::ServerList::preferred));
  owner_.finish();
  servers_.left();
  part(true);
}

void ConnectionLife::end() {
  bool in_order = true;
  try {
    if (broken_) std::rethrow_exception(broken_);
    owner_.finish();
  } catch (const std::exception& error) {
    if (servers_.current()) log_.lost(cluster_.name(*servers_.current()), error.what());
    in_order = false;
  }
  part(in_order);
}

void ConnectionLife::sleep() {
  using std::chrono::milliseconds;
  ready_ = Readiness();
  const Rest rest = owner_.rest();
  if (rest.unread && !broken_) return;
  milliseconds limit = broken_ ? milliseconds(0) : rest.limit;
  if (!open_) {
    const auto left = std::chrono::ceil<milliseconds>(servers_.next_attempt() - clock_.now());
    limit = std::clamp(left, milliseconds(0), limit);
  } else if (moving_since_) {
    limit = std::min(limit, moving_period);
  }
  sleep_.watch(rest.socket, rest.want_write);
  sleeping_ = limit.count() > 0;
  ConnectionSleep::Result woken;
  {
    const config::Unlocked unlocked(mutex_);
    woken = sleep_.wait(limit);
  }
  sleeping_ = false;
  ready_.readable = woken.readable || (limit.count() > 0 && !woken.writable);
  ready_.writable = woken.writable;
}

}  // namespace iotcloud::brokers::rabbitmq
