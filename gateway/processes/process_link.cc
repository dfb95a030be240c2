#include <algorithm>
#include <array>
#include <cstring>

#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/signing/sha256.h>
#include <iotcloud/gateway/processes/process_link.h>
#include <iotcloud/gateway/processes/silence.h>

namespace iotcloud::gateway {

using protocol::Command;
using protocol::Event;
using std::chrono::milliseconds;
using Steady = std::chrono::steady_clock;

namespace {

constexpr config::Logger log{"gateway"};
constexpr milliseconds connect_pause{10}, longest_connect_pause{100};
constexpr milliseconds death_limit{5000};

std::string how_it_ended(int status) {
  if (WIFSIGNALED(status)) {
    return fmt::format("crashed (signal {}, {})", WTERMSIG(status), strsignal(WTERMSIG(status)));
  }
  return fmt::format("exited with status {}", WEXITSTATUS(status));
}

/// Two versions of a plugin that was sent may run beside each other.
std::string name_in_metrics(const HostOrder& order) {
  const std::string name = order.plugin.substr(0, order.plugin.rfind('.'));
  return order.sha256.empty() ? name : name + "@" + config::short_sha256(order.sha256);
}

}  // namespace

ProcessLink::ProcessLink(const ProcessLauncher::Options& options, const HostOrder& order, std::string socket_name,
                         int process, bool child, HostEvents events, std::function<void()> keep_log)
    : options_(options),
      order_(order),
      socket_name_(std::move(socket_name)),
      process_(process),
      child_(child),
      events_(std::move(events)),
      keep_log_(std::move(keep_log)),
      process_descriptor_(static_cast<int>(syscall(SYS_pidfd_open, process, 0))),
      next_ping_(Steady::now()),
      next_metrics_(Steady::now()),
      name_(name_in_metrics(order)),
      vitals_(fmt::format("/proc/{}", process), options.limits),
      thread_([this] { run(); }) {}

ProcessLink::~ProcessLink() {
  leaving_ = true;
  waker_.wake();
}

void ProcessLink::send(const Command& command) {
  const std::lock_guard lock(mutex_);
  if (shutting_down_) return;
  waiting_.push_back(encode(command));
  waker_.wake();
}

void ProcessLink::create(const InstanceSpec& spec) {
  Command command;
  command.kind = Command::Kind::create;
  command.spec = spec;
  send(command);
}

void ProcessLink::activate(const std::string& instance) {
  send({Command::Kind::activate, instance, {}, 0});
}

void ProcessLink::deactivate(const std::string& instance) {
  send({Command::Kind::deactivate, instance, {}, 0});
}

void ProcessLink::remove(const std::string& instance) {
  send({Command::Kind::remove, instance, {}, 0});
}

void ProcessLink::shutdown(milliseconds limit) {
  send({Command::Kind::shutdown, "", {}, std::max<std::int64_t>(1, limit.count())});
  const std::lock_guard lock(mutex_);
  shutting_down_ = true;
  shutdown_deadline_ = std::min(shutdown_deadline_, Steady::now() + limit);
}

void ProcessLink::run() noexcept try {
  if (connect()) converse();
  if (leaving_) return;
  tell_end(wait_for_end());
} catch (const std::exception& e) {
  log.error("the link to the driver host {}: {}", socket_name_, e.what());
  if (leaving_) return;
  killed_ = e.what();
  kill_process();
  tell_end({HostEnd::How::crashed, fmt::format("was ended: {}", e.what()), ""});
}

void ProcessLink::tell_end(const HostEnd& end) {
  if (options_.metrics) options_.metrics->forget(name_, process_);
  if (!leaving_) events_.on_ended(end);
}

/// Until the host listens, ends, or takes too long. \return whether there is a connection.
bool ProcessLink::connect() {
  Silence silence(Steady::now(), longest_connect_pause);
  while (!leaving_) {
    socket_ = connect_in(options_.state_dir, socket_name_);
    if (socket_) return true;
    if (wait_readable(process_descriptor_.get(), connect_pause)) return false;  // it has ended
    if (overdue({})) return false;
    if (silence.look(Steady::now()) < options_.hang_limit) continue;
    killed_ = fmt::format("hung: it did not listen within {} ms", options_.hang_limit.count());
    kill_process();
    return false;
  }
  return false;
}

void ProcessLink::converse() {
  Silence silence(Steady::now(), std::min(2 * options_.ping_period, options_.hang_limit / 2));
  while (!leaving_) {
    std::array<pollfd, 3> on{
        {{socket_.get(), POLLIN, 0}, {waker_.get(), POLLIN, 0}, {process_descriptor_.get(), POLLIN, 0}}};
    poll(on.data(), on.size(), static_cast<int>(time_to_wait().count()));
    if (leaving_) return;
    if (on[1].revents != 0) waker_.clear();
    if (!send_waiting()) return;
    if (on[0].revents != 0) {
      if (!receive()) return;
      silence.heard();
    }
    if (on[0].revents == 0 && on[2].revents != 0) return;  // ended, and nothing is left to read
    ping();
    if (overdue(silence.look(Steady::now()))) return;
  }
}

milliseconds ProcessLink::time_to_wait() const {
  const auto now = Steady::now();
  const auto left = std::chrono::ceil<milliseconds>(next_ping_ - now);
  return std::clamp(left, milliseconds{0}, options_.ping_period);
}

bool ProcessLink::send_waiting() {
  std::vector<std::string> now;
  {
    const std::lock_guard lock(mutex_);
    now.swap(waiting_);
  }
  return std::all_of(now.begin(), now.end(), [&](const auto& bytes) { return send_all(socket_, bytes); });
}

bool ProcessLink::receive() {
  const auto bytes = receive_some(socket_);
  if (!bytes) return false;
  frames_.feed(bytes->data(), bytes->size());
  while (const auto body = frames_.next()) heard(protocol::decode_event(*body));
  return true;
}

void ProcessLink::heard(const Event& event) {
  switch (event.kind) {
    case Event::Kind::hello:
      for (const auto& instance : event.instances) {
        name_after(instance.status.instance);
        events_.on_status(instance.status);
      }
      break;
    case Event::Kind::status:
      name_after(event.status.instance);
      events_.on_status(event.status);
      break;
    case Event::Kind::refused:
      refused_ = event.reason;
      shutdown(death_limit);
      break;
    case Event::Kind::pong:
      judge(event.stalls);
      break;
    case Event::Kind::metrics:
      show_metrics(event.samples);
      break;
  }
}

void ProcessLink::name_after(const std::string& instance) {
  if (!order_.isolated || name_.find('#') != std::string::npos) return;
  if (options_.metrics) options_.metrics->forget(name_, process_);
  name_ += "#" + instance;
}

void ProcessLink::judge(const std::vector<Stall>& stalls) {
  for (const auto& stall : stalls) {
    const auto limit = stall.limit.value_or(stall.own_thread ? options_.own_thread_hang_limit : options_.hang_limit);
    if (limit.count() == 0 || stall.time < limit) continue;
    killed_ = fmt::format("hung: a callback of {} has been running for {} ms",
                          stall.instance.empty() ? "a driver" : stall.instance, stall.time.count());
    culprit_ = stall.instance;
    kill_process();
    return;
  }
}

void ProcessLink::ping() {
  const auto now = Steady::now();
  if (now < next_ping_) return;
  next_ping_ = now + options_.ping_period;
  send({Command::Kind::ping, "", {}, 1});
  ask_for_metrics(now);
  if (keep_log_) keep_log_();
  const std::string excess = vitals_.examine(now);
  if (excess.empty() || !killed_.empty()) return;
  killed_ = excess;
  kill_process();
}

void ProcessLink::ask_for_metrics(Instant now) {
  if (!options_.metrics || now < next_metrics_) return;
  next_metrics_ = now + options_.metrics_period;
  send({Command::Kind::metrics, "", {}, 0});
}

void ProcessLink::show_metrics(std::vector<config::Sample> samples) {
  if (!options_.metrics) return;
  config::Sample memory;
  memory.name = "iotcloud_host_memory_bytes";
  memory.help = "Memory that a driver host takes";
  memory.kind = config::Sample::Kind::gauge;
  memory.value = static_cast<double>(vitals_.memory_bytes());
  samples.push_back(std::move(memory));
  options_.metrics->put(name_, process_, std::move(samples));
}

/// Kills a host that does not answer, or that did not shut down in time. \return whether it did.
bool ProcessLink::overdue(std::chrono::nanoseconds silent) {
  std::unique_lock lock(mutex_);
  const bool shutting_down = shutting_down_;
  if (shutting_down && Steady::now() > shutdown_deadline_) {
    killed_ = "did not shut down in time and was killed";
  } else if (!shutting_down && silent > options_.hang_limit) {
    killed_ = fmt::format("hung: no answer for {} ms", options_.hang_limit.count());
  } else {
    return false;
  }
  lock.unlock();
  kill_process();
  return true;
}

void ProcessLink::kill_process() {
  if (process_descriptor_) syscall(SYS_pidfd_send_signal, process_descriptor_.get(), SIGKILL, nullptr, 0);
}

HostEnd ProcessLink::wait_for_end() {
  if (process_descriptor_ && !wait_readable(process_descriptor_.get(), death_limit)) {
    if (killed_.empty()) killed_ = "closed its connection and went on; it was killed";
    kill_process();
    wait_readable(process_descriptor_.get(), death_limit);
  }
  int status = 0;
  const bool known = child_ && waitpid(process_, &status, 0) == process_;
  unlink((options_.state_dir + "/" + socket_name_).c_str());
  const std::lock_guard lock(mutex_);
  if (!refused_.empty()) return {HostEnd::How::refused, refused_, ""};
  if (shutting_down_) return {HostEnd::How::stopped, killed_, ""};
  if (!killed_.empty()) return {HostEnd::How::crashed, killed_, culprit_};
  return {HostEnd::How::crashed, known ? how_it_ended(status) : "died", ""};
}

}  // namespace iotcloud::gateway
