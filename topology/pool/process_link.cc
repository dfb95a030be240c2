#include <algorithm>
#include <array>
#include <system_error>

#include <fmt/format.h>
#include <poll.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/unix_socket.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/process_link.h>

namespace iotcloud::topology {

using std::chrono::milliseconds;
using Steady = std::chrono::steady_clock;

namespace {

constexpr milliseconds connect_pause{5}, longest_connect_pause{100};
/// How long a process that has closed its connection, or was killed, may take to end.
constexpr milliseconds death_limit{5000};
/// A worker ends itself when its limit is over; only one that does not is killed, this much later.
constexpr milliseconds stop_margin{2000};

}  // namespace

ProcessLink::ProcessLink(Options options, const processes::VitalLimits& limits, processes::ChildProcess& process,
                         WorkerEvents events)
    : options_(std::move(options)),
      process_(std::move(process)),
      events_(std::move(events)),
      next_ping_(Steady::now()),
      vitals_(fmt::format("/proc/{}", process_.id()), limits) {
  try {
    thread_ = std::jthread([this] { run(); });
  } catch (const std::system_error&) {
    process_.kill();
    static_cast<void>(process_.how_it_ended());
    throw;
  }
}

ProcessLink::~ProcessLink() {
  leaving_ = true;
  waker_.wake();
}

void ProcessLink::stop(milliseconds limit) {
  const config::MutexLock lock(mutex_);
  const auto deadline = Steady::now() + limit + stop_margin;
  stop_deadline_ = std::min(stop_deadline_.value_or(deadline), deadline);
  waker_.wake();
}

void ProcessLink::run() noexcept {
  try {
    if (connect()) converse();
  } catch (const std::exception& e) {
    pool_logger.error("the link to the worker in {}: {}", options_.folder, e.what());
    if (!leaving_) kill(fmt::format("was ended: {}", e.what()));
  }
  if (leaving_) return;
  const auto ending = wait_for_end();
  if (!leaving_) events_.on_ended(ending);
}

/// Tries until the worker listens, ends, or takes too long. \return whether the link is connected.
bool ProcessLink::connect() {
  processes::Silence silence(Steady::now(), longest_connect_pause);
  while (!leaving_) {
    socket_ = processes::connect_in(options_.folder, pooled::socket_name);
    if (socket_) {
      const int peer = processes::peer_process(socket_);
      if (peer != process_.id())
        throw config::Error(fmt::format("process {} has its socket, which is {}", peer, process_.id()));
      return true;
    }
    if (processes::wait_readable(process_.ended(), connect_pause)) return false;  // it has ended
    if (overdue(silence.measure(Steady::now()))) return false;
  }
  return false;
}

void ProcessLink::converse() {
  processes::Silence silence(Steady::now(), std::min(2 * options_.ping_period, options_.hang_limit / 2));
  while (!leaving_) {
    std::array<pollfd, 3> on{{{socket_.get(), POLLIN, 0}, {waker_.get(), POLLIN, 0}, {process_.ended(), POLLIN, 0}}};
    const auto left = std::chrono::ceil<milliseconds>(next_ping_ - Steady::now());
    poll(on.data(), on.size(), static_cast<int>(std::clamp(left, milliseconds{0}, options_.ping_period).count()));
    if (leaving_) return;
    if (on[1].revents != 0) waker_.clear();
    if (!send_stop()) return;
    if (on[0].revents != 0) {
      if (!receive()) return;
      silence.heard();
    }
    if (on[0].revents == 0 && on[2].revents != 0) return;  // it has ended and nothing is left to read
    ping();
    if (overdue(silence.measure(Steady::now()))) return;
  }
}

/// Tells the worker to stop, once, if it is to. \return false if it is gone.
bool ProcessLink::send_stop() {
  {
    const config::MutexLock lock(mutex_);
    if (!stop_deadline_ || stop_sent_) return true;
  }
  stop_sent_ = true;
  return processes::send_all(socket_, pooled::encode(pooled::PoolCommand{true}));
}

bool ProcessLink::receive() {
  const auto bytes = processes::receive_some(socket_);
  if (!bytes) return false;
  frames_.feed(bytes->data(), bytes->size());
  while (const auto body = frames_.next()) {
    const auto report = pooled::decode_report(*body);
    watch_calls(report);
    events_.on_report(report);
  }
  return true;
}

/// Kills the worker if one call of a component takes too long. The worker says so twice, because a machine that stood
/// still makes a short call look long, once.
void ProcessLink::watch_calls(const pooled::WorkerReport& report) {
  const bool is_long = options_.call_limit.count() > 0 && report.call_ms > options_.call_limit.count();
  long_calls_ = is_long ? long_calls_ + 1 : 0;
  if (long_calls_ < 2) return;
  kill(fmt::format("hung: {}/{} did not return from a call for {} ms", report.component, report.task, report.call_ms));
}

void ProcessLink::kill(const std::string& why) {
  if (!killed_.empty()) return;
  killed_ = why;
  process_.kill();
}

void ProcessLink::ping() {
  const auto now = Steady::now();
  if (now < next_ping_) return;
  next_ping_ = now + options_.ping_period;
  processes::send_all(socket_, pooled::encode(pooled::PoolCommand{}));
  const std::string excess = vitals_.examine(now);
  if (!excess.empty()) kill(excess);
}

/// Kills the worker if it has not answered for too long or did not stop in time. \return whether it was killed.
bool ProcessLink::overdue(std::chrono::nanoseconds silent) {
  {
    const config::MutexLock lock(mutex_);
    if (stop_deadline_ && Steady::now() > *stop_deadline_) {
      killed_ = "did not stop in time and was killed";
    } else if (!stop_deadline_ && silent > options_.hang_limit) {
      killed_ = fmt::format("hung: no answer for {} ms", options_.hang_limit.count());
    } else {
      return false;
    }
  }
  process_.kill();
  return true;
}

WorkerEnding ProcessLink::wait_for_end() {
  while (!leaving_ && !process_.wait(death_limit)) {
    const config::MutexLock lock(mutex_);
    if (stop_deadline_ && Steady::now() < *stop_deadline_) continue;  // it has closed its connection, and drains
    if (killed_.empty()) killed_ = "closed its connection and went on; it was killed";
    process_.kill();
  }
  if (leaving_) return {};
  const std::string how = process_.how_it_ended();
  const auto word = pooled::read_end(options_.folder);
  pooled::remove_worker(options_.folder);
  const config::MutexLock lock(mutex_);
  if (stop_deadline_) return {WorkerEnding::How::stopped, killed_};
  if (!killed_.empty()) return {WorkerEnding::How::failed, killed_};
  if (word) return {word->refused ? WorkerEnding::How::refused : WorkerEnding::How::failed, word->reason};
  return {WorkerEnding::How::failed, how};
}

}  // namespace iotcloud::topology
