#include <algorithm>
#include <array>
#include <system_error>
#include <utility>

#include <fmt/format.h>
#include <poll.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/logger.h>
#include <iotcloud/processes/process_watch.h>
#include <iotcloud/processes/silence.h>

namespace iotcloud::processes {

using std::chrono::milliseconds;
using Steady = std::chrono::steady_clock;

namespace {

constexpr milliseconds connect_pause{5}, longest_connect_pause{100};
/// How long a process that has closed its connection, or was killed, may take to end.
constexpr milliseconds death_limit{5000};

}  // namespace

ProcessWatch::ProcessWatch(Options options, ChildProcess process, Events events) try
    : options_(std::move(options)),
      process_(std::move(process)),
      events_(std::move(events)),
      next_ping_(Steady::now()),
      vitals_(fmt::format("/proc/{}", process_.id()), options_.limits) {
  try {
    thread_ = std::jthread([this] { run(); });
  } catch (const std::system_error&) {
    process_.kill();
    static_cast<void>(process_.how_it_ended());
    throw;
  }
} catch (const std::exception&) {
  process.kill();  // nothing, if it was taken over before
  static_cast<void>(process.how_it_ended());
}

ProcessWatch::~ProcessWatch() {
  leaving_ = true;
  waker_.wake();
}

void ProcessWatch::send(std::string frame) {
  const config::MutexLock lock(mutex_);
  if (stop_deadline_) return;
  waiting_.push_back(std::move(frame));
  waker_.wake();
}

void ProcessWatch::stop(std::string frame, milliseconds limit) {
  const config::MutexLock lock(mutex_);
  // Both at once: the process may end as soon as it has the frame, and then it must count as told.
  if (!stop_deadline_) waiting_.push_back(std::move(frame));
  const auto deadline = Steady::now() + limit + options_.stop_margin;
  stop_deadline_ = std::min(stop_deadline_.value_or(deadline), deadline);
  waker_.wake();
}

bool ProcessWatch::kill(const std::string& why) {
  if (!killed_.empty()) return false;
  killed_ = why;
  process_.kill();
  return true;
}

void ProcessWatch::run() noexcept {
  try {
    if (connect()) converse();
  } catch (const std::exception& error) {
    logger.error("process {}, {}/{}: {}", process_.id(), options_.folder, options_.socket, error.what());
    if (!leaving_) kill(fmt::format("was ended: {}", error.what()));
  }
  if (leaving_) return;
  const auto end = wait_for_end();
  if (!leaving_) events_.on_end(end);
}

/// Tries until the process listens, ends, or takes too long. \return whether it is connected. \throws config::Error if
/// another process listens there
bool ProcessWatch::connect() {
  Silence silence(Steady::now(), longest_connect_pause);
  while (!leaving_) {
    socket_ = connect_in(options_.folder, options_.socket);
    if (socket_) {
      const int peer = peer_process(socket_);
      if (peer != process_.id())
        throw config::Error(fmt::format("process {} has its socket, which is {}", peer, process_.id()));
      return send_all(socket_, options_.greeting);
    }
    if (wait_readable(process_.ended(), connect_pause)) return false;  // it has ended
    if (overdue({})) return false;
    if (silence.measure(Steady::now()) < options_.hang_limit) continue;
    kill(fmt::format("hung: it did not listen within {} ms", options_.hang_limit.count()));
    return false;
  }
  return false;
}

void ProcessWatch::converse() {
  Silence silence(Steady::now(), std::min(2 * options_.ping_period, options_.hang_limit / 2));
  while (!leaving_) {
    const auto wanted = static_cast<short>(outbox_.empty() ? POLLIN : POLLIN | POLLOUT);
    std::array<pollfd, 3> on{{{socket_.get(), wanted, 0}, {waker_.get(), POLLIN, 0}, {process_.ended(), POLLIN, 0}}};
    const auto left = std::chrono::ceil<milliseconds>(next_ping_ - Steady::now());
    poll(on.data(), on.size(), static_cast<int>(std::clamp(left, milliseconds{0}, options_.ping_period).count()));
    if (leaving_) return;
    if (on[1].revents != 0) waker_.clear();
    const bool says_something = (on[0].revents & ~POLLOUT) != 0;
    if (says_something) {
      if (!receive()) return;
      silence.heard();
    }
    if (!says_something && on[2].revents != 0) return;  // it has ended and nothing is left to read
    if (!send_waiting()) return;
    ping();
    if (overdue(silence.measure(Steady::now()))) return;
  }
}

/// \return false if the process is gone.
bool ProcessWatch::send_waiting() {
  {
    const config::MutexLock lock(mutex_);
    for (const auto& bytes : waiting_) outbox_.add(bytes);
    waiting_.clear();
  }
  return outbox_.send(socket_);
}

/// \return false if the process is gone.
bool ProcessWatch::receive() {
  const auto bytes = receive_some(socket_);
  if (!bytes) return false;
  asked_ = false;
  frames_.feed(bytes->data(), bytes->size());
  while (const auto body = frames_.next()) events_.on_frame(*body);
  return true;
}

void ProcessWatch::ping() {
  const auto now = Steady::now();
  if (now < next_ping_) return;
  next_ping_ = now + options_.ping_period;
  // A process that does not read is not asked again: its socket would be full one day, and it would count as gone.
  if (!std::exchange(asked_, true)) events_.on_ping();
  const std::string excess = vitals_.examine(now);
  if (!excess.empty()) kill(excess);
}

/// Kills the process if it has not answered for too long or did not stop in time. \return whether it was killed.
bool ProcessWatch::overdue(std::chrono::nanoseconds silent) {
  const auto deadline = [this] {
    const config::MutexLock lock(mutex_);
    return stop_deadline_;
  }();
  if (deadline && Steady::now() > *deadline) {
    kill("did not stop in time and was killed");
  } else if (!deadline && silent > options_.hang_limit) {
    kill(fmt::format("hung: no answer for {} ms", options_.hang_limit.count()));
  } else {
    return false;
  }
  return true;
}

WatchedEnd ProcessWatch::wait_for_end() {
  while (!leaving_ && !process_.wait(death_limit)) {
    {
      const config::MutexLock lock(mutex_);
      if (stop_deadline_ && Steady::now() < *stop_deadline_) continue;  // it has closed its connection, and drains
    }
    kill("closed its connection and went on; it was killed");
  }
  if (leaving_) return {};
  const config::MutexLock lock(mutex_);
  return {stop_deadline_.has_value(), killed_, process_.how_it_ended()};
}

}  // namespace iotcloud::processes
