#include <algorithm>
#include <future>

#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/client/client_state.h>
#include <iotcloud/discovery/logger.h>

namespace iotcloud::discovery {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds first_complaint{1000};
constexpr milliseconds repeat_pause{20};
constexpr milliseconds renew_pause{500};

struct SessionMetrics {
  config::Gauge& connected = config::process_metrics().gauge("iotcloud_registry_connected",
                                                             "Registry clients of this process that are connected");
  config::Counter& losses = config::process_metrics().counter("iotcloud_registry_disconnects_total",
                                                              "Connections to the registry that were lost");
  config::Counter& expiries = config::process_metrics().counter("iotcloud_registry_expired_sessions_total",
                                                                "Sessions that the registry dropped");
};

SessionMetrics& metrics() {
  static SessionMetrics all;
  return all;
}

}  // namespace

struct ClientState::WatchGuard : Guard {
  WatchGuard(std::weak_ptr<ClientState> c, std::shared_ptr<Watch> w) : state(std::move(c)), watch(std::move(w)) {}
  ~WatchGuard() override {
    watch->shut();
    if (const auto alive = state.lock()) {
      alive->worker_.post([state = alive.get(), watch = watch] { state->watches_.remove(watch); });
    }
  }
  std::weak_ptr<ClientState> state;
  std::shared_ptr<Watch> watch;
};

struct ClientState::HoldGuard : Guard {
  HoldGuard(std::weak_ptr<ClientState> c, std::shared_ptr<Hold> h) : state(std::move(c)), hold(std::move(h)) {}
  ~HoldGuard() override {
    hold->on_created->shut();
    // The removal has been sent when this returns: this thread's later calls find the node gone.
    if (const auto alive = state.lock()) {
      alive->on_worker_and_wait([state = alive.get(), hold = hold] { state->holds_.release(hold); });
    }
  }
  std::weak_ptr<ClientState> state;
  std::shared_ptr<Hold> hold;
};

struct ClientState::ListenerGuard : Guard {
  ListenerGuard(std::weak_ptr<ClientState> c, std::shared_ptr<SessionCallback> l, std::uint64_t n)
      : state(std::move(c)), listener(std::move(l)), number(n) {}
  ~ListenerGuard() override {
    listener->shut();
    if (const auto alive = state.lock()) {
      alive->worker_.post([state = alive.get(), number = number] { state->listeners_.erase(number); });
    }
  }
  std::weak_ptr<ClientState> state;
  std::shared_ptr<SessionCallback> listener;
  const std::uint64_t number;
};

struct ClientState::TimerGuard : Guard {
  explicit TimerGuard(std::shared_ptr<SessionCallback> c) : callback(std::move(c)) {}
  ~TimerGuard() override { callback->shut(); }
  std::shared_ptr<SessionCallback> callback;
};

void ClientState::open() {
  RegistryConnection::Events events;
  events.connected = [this](std::int64_t session, milliseconds timeout) {
    worker_.post([this, session, timeout] { on_connected(session, timeout); });
  };
  events.disconnected = [this] { worker_.post([this, when = Clock::now()] { on_disconnected(when); }); };
  events.expired = [this] { worker_.post([this] { on_expired(); }); };
  events.changed = [this](const std::string& path) {
    worker_.post([this, path] {
      watches_.changed(path);
      holds_.changed(path);
    });
  };
  worker_.post([this, events = std::move(events)]() mutable {
    if (!connection_->open(std::move(events))) renew_later();
  });
  worker_.post_at(Clock::now() + first_complaint, [this] {
    if (link_changes_ == 0)
      logger.warn(
          "the registry {} cannot be reached yet; trying on. Is its server running, and is this its address "
          "(registry: in a daemon's file, zk.servers in a topology's)?",
          options_.url);
  });
}

void ClientState::close() {
  {
    const config::MutexLock lock(mutex_);
    closed_ = true;
    state_ = SessionState::closed;
    changed_.notify_all();
  }
  worker_.stop();
  dispatcher_.stop();
  connection_.reset();
  if (linked_) metrics().connected.add(-1);
}

void ClientState::on_connected(std::int64_t session, milliseconds timeout) {
  timeout_ = timeout;
  ++link_changes_;
  if (!std::exchange(linked_, true)) metrics().connected.add(1);
  renewed_in_vain_ = false;
  connection_->ask_no_more();
  logger.info("connected to the registry {}", options_.url);
  {
    const config::MutexLock lock(mutex_);
    why_away_.clear();
  }
  enter(SessionState::connected);
  holds_.connected(session);
  watches_.connected();
}

void ClientState::on_disconnected(Clock::time_point when) {
  if (!std::exchange(linked_, false)) return;
  metrics().connected.add(-1);
  metrics().losses.add();
  logger.warn("lost the connection to the registry {}; connecting again", options_.url);
  holds_.disconnected();
  watches_.disconnected();
  enter(SessionState::connecting);
  const auto change = ++link_changes_;
  worker_.post_at(when + connection_->certain_after_disconnect(timeout_), [this, change] {
    if (link_changes_ != change) return;
    logger.warn("the session with the registry {} may be over: no contact for too long", options_.url);
    enter(SessionState::expired);
  });
  worker_.post_at(when + moment(), [this, change] { ask_for_new(change); });
}

/// How long something may take that is immediate when all is well: a part of the session's time-out.
milliseconds ClientState::moment() const {
  return timeout_ / 6;
}

void ClientState::ask_for_new(std::uint64_t change) {
  if (link_changes_ != change) return;
  const bool asked = connection_->ask_for_new([this, change] { worker_.post([this, change] { on_serving(change); }); });
  if (!asked) worker_.post_at(Clock::now() + renew_pause, [this, change] { ask_for_new(change); });
}

/// Called when a server takes new sessions and this client still has no connection. Beginning its session was a write,
/// so the server has all that this client ever saw, unless the server was emptied or put back to an earlier state. A
/// server that has it takes the old session back at the next attempt, or says that it has expired. A server that does
/// neither has an earlier state, and will never answer this session.
void ClientState::on_serving(std::uint64_t change) {
  if (link_changes_ != change) return;
  const auto wait = connection_->longest_attempt(timeout_) + moment();
  {
    const config::MutexLock lock(mutex_);
    why_away_ =
        "it runs and does not take this session back: it was emptied or put back to an earlier state, or was not "
        "ready. A new session begins within " +
        std::to_string(wait.count()) + " ms";
  }
  worker_.post_at(Clock::now() + wait, [this, change] {
    if (link_changes_ != change) return;
    logger.warn("the registry {} serves others and not this session: it was emptied, or put back to an earlier state",
                options_.url);
    on_expired();
  });
}

void ClientState::on_expired() {
  if (std::exchange(linked_, false)) metrics().connected.add(-1);
  metrics().expiries.add();
  connection_->ask_no_more();
  ++link_changes_;
  {
    const config::MutexLock lock(mutex_);
    why_away_.clear();
  }
  logger.warn("the registry {} has dropped the session; starting a new one", options_.url);
  holds_.disconnected();
  watches_.disconnected();
  enter(SessionState::expired);
  // If this session expired before it was ever connected, wait a moment before the next attempt.
  if (std::exchange(renewed_in_vain_, true) || !connection_->renew()) renew_later();
}

void ClientState::renew_later() {
  worker_.post_at(Clock::now() + renew_pause, [this] {
    if (!connection_->renew()) renew_later();
  });
}

void ClientState::enter(SessionState state) {
  {
    const config::MutexLock lock(mutex_);
    if (closed_ || state_ == state) return;
    state_ = state;
    changed_.notify_all();
  }
  for (const auto& [number, listener] : listeners_) listener->deliver_each(dispatcher_, state);
}

Reply ClientState::call(const std::string& what, const std::function<void(RegistryConnection&, Done)>& operation,
                        bool* in_doubt) {
  const auto deadline = Clock::now() + options_.operation_timeout;
  bool lost_once = false;
  config::UniqueLock lock(mutex_);
  const auto give_up = [&](const std::string& problem) {
    const std::string seconds = std::to_string(options_.operation_timeout.count()) + " ms";
    mutex_.assert_held();
    return RegistryError(RegistryErrorCode::away, what + ": " + problem + " within " + seconds + " from the registry " +
                                                      options_.url + "; " +
                                                      (why_away_.empty() ? std::string("is it running?") : why_away_));
  };
  const auto wait_until = [&](Clock::time_point limit, const auto& condition) {
    mutex_.assert_held();
    changed_.wait_until(mutex_, limit, [&] {
      mutex_.assert_held();
      return closed_ || condition();
    });
    if (closed_) throw RegistryError(RegistryErrorCode::closed, what + ": the registry was closed");
    return condition();
  };
  for (;;) {
    if (!wait_until(deadline, [this]() IOTCLOUD_REQUIRES(mutex_) { return state_ == SessionState::connected; })) {
      throw give_up(lost_once ? "no second answer after the connection was lost" : "no connection");
    }
    const auto pending = std::make_shared<Pending>();
    lock.unlock();
    operation(*connection_, [this, pending](Reply reply) {
      const config::MutexLock answer_lock(mutex_);
      pending->reply = std::move(reply);
      changed_.notify_all();
    });
    lock.lock();
    if (!wait_until(deadline, [&] { return pending->reply.has_value(); })) throw give_up("no answer");
    if (pending->reply->status != ReplyStatus::away) {
      if (in_doubt != nullptr) *in_doubt = lost_once;
      return std::move(*pending->reply);
    }
    lost_once = true;
    wait_until(std::min(deadline, Clock::now() + repeat_pause),
               [this]() IOTCLOUD_REQUIRES(mutex_) { return state_ != SessionState::connected; });
  }
}

void ClientState::on_worker_and_wait(std::function<void()> task) {
  auto packaged = std::make_shared<std::packaged_task<void()>>(std::move(task));
  const auto done = packaged->get_future();
  // From here on only the worker's queue owns the task. If the worker has stopped, it drops the task, which also ends
  // the wait below.
  worker_.post([packaged = std::move(packaged)] { (*packaged)(); });
  done.wait();
}

GuardPtr ClientState::add_watch(std::shared_ptr<Watch> watch) {
  worker_.post([this, watch] { watches_.add(watch); });
  return std::make_unique<WatchGuard>(weak_from_this(), std::move(watch));
}

GuardPtr ClientState::add_hold(std::shared_ptr<Hold> hold, bool wait, ReplyStatus& refusal) {
  refusal = ReplyStatus::ok;
  GuardPtr guard;
  const auto add = [&] {
    // From here on the guard cleans up, even if the answer does not come in time.
    guard = std::make_unique<HoldGuard>(weak_from_this(), hold);
    worker_.post([this, hold] { holds_.add(hold); });
  };
  if (!wait) {
    add();
    return guard;
  }
  const auto create = [&](RegistryConnection&, Done done) {
    hold->first_answer = [done = std::move(done)](ReplyStatus status) {
      Reply reply;
      reply.status = status;
      done(std::move(reply));
    };
    add();
  };
  refusal = call("create " + hold->path, create, nullptr).status;
  if (refusal != ReplyStatus::ok) guard.reset();
  return guard;
}

GuardPtr ClientState::add_listener(std::function<void(SessionState)> callback) {
  auto listener = std::make_shared<SessionCallback>(std::move(callback));
  const std::uint64_t number = ++last_listener_;
  worker_.post([this, listener, number] {
    listeners_.emplace(number, listener);
    listener->deliver_each(dispatcher_, session());
  });
  return std::make_unique<ListenerGuard>(weak_from_this(), std::move(listener), number);
}

GuardPtr ClientState::add_timer(milliseconds pause, std::function<void()> callback) {
  auto once = std::make_shared<SessionCallback>([callback = std::move(callback)](SessionState) { callback(); });
  worker_.post_at(Clock::now() + pause, [this, once] { once->deliver_each(dispatcher_, session()); });
  return std::make_unique<TimerGuard>(std::move(once));
}

}  // namespace iotcloud::discovery
