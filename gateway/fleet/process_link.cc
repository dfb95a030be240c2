#include <algorithm>
#include <array>
#include <cstring>
#include <variant>

#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <iotcloud/gateway/fleet/process_link.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/processes/silence.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

using std::chrono::milliseconds;
using Steady = std::chrono::steady_clock;

namespace {

constexpr milliseconds connect_pause{10}, longest_connect_pause{100};
constexpr milliseconds death_limit{5000};

/// The plugin's name, with part of its SHA-256 if it was uploaded, because two versions may run at once.
std::string name_in_metrics(const HostOrder& order) {
  const std::string name = order.plugin.substr(0, order.plugin.rfind('.'));
  return order.sha256.empty() ? name : name + "@" + security::short_sha256(order.sha256);
}

}  // namespace

ProcessLink::ProcessLink(const ProcessLauncher::Options& options, const HostOrder& order, std::string socket_name,
                         std::string proof, processes::ChildProcess process, HostEvents events,
                         std::function<void()> keep_log)
    : options_(options),
      order_(order),
      socket_name_(std::move(socket_name)),
      proof_(std::move(proof)),
      process_(std::move(process)),
      events_(std::move(events)),
      keep_log_(std::move(keep_log)),
      next_ping_(Steady::now()),
      next_metrics_(Steady::now()),
      name_(name_in_metrics(order)),
      vitals_(fmt::format("/proc/{}", process_.id()), options.limits),
      thread_([this] { run(); }) {}

ProcessLink::~ProcessLink() {
  leaving_ = true;
  waker_.wake();
}

void ProcessLink::send(const protocol::HostCommand& command) {
  send(encode(command));
}

void ProcessLink::send(std::string frame) {
  const config::MutexLock lock(mutex_);
  if (shutting_down_) return;
  waiting_.push_back(std::move(frame));
  waker_.wake();
}

void ProcessLink::create(const InstanceSpec& spec) {
  send(protocol::CreateInstance{spec});
}

void ProcessLink::activate(const discovery::InstanceId& instance) {
  send(protocol::ActivateInstance{instance});
}

void ProcessLink::deactivate(const discovery::InstanceId& instance) {
  send(protocol::DeactivateInstance{instance});
}

void ProcessLink::remove(const discovery::InstanceId& instance, Removal removal) {
  send(protocol::RemoveInstance{instance, removal});
}

void ProcessLink::deliver(const PassedMessage& passed) {
  std::string bytes = encode(protocol::DeliverMessage{passed});
  if (processes::fits(bytes)) {
    send(std::move(bytes));
  } else if (events_.on_answer) {
    events_.on_answer(passed.number, PassAnswer::nowhere);
  }
}

void ProcessLink::answer(std::int64_t number, PassAnswer answer) {
  send(protocol::AnswerMessage{number, answer});
}

void ProcessLink::renew(config::Clock::Instant confirmed) {
  send(protocol::RenewLeases{confirmed.time_since_epoch()});
}

void ProcessLink::ask(std::int64_t number, const ChannelQuestion& question) {
  std::string problem;
  {
    const config::MutexLock lock(mutex_);
    if (!answers_) problem = "its driver host is just starting; try again";
    if (answers_ && !*answers_) {
      problem =
          "its driver host was started by an earlier version of the gateway, which shows no channels: deploy the "
          "instance again, or update its plugin";
    }
  }
  std::string bytes = encode(protocol::AskAboutChannel{number, question});
  if (problem.empty() && !processes::fits(bytes))
    problem = "the message is too large: 4 MB, properties included, are the most";
  if (problem.empty()) {
    send(std::move(bytes));
  } else if (events_.on_told) {
    discovery::ChannelLook look;
    look.problem = problem;
    events_.on_told(number, std::move(look));
  }
}

void ProcessLink::shutdown(milliseconds limit) {
  send(protocol::ShutDown{std::max(milliseconds{1}, limit)});
  const config::MutexLock lock(mutex_);
  shutting_down_ = true;
  shutdown_deadline_ = std::min(shutdown_deadline_, Steady::now() + limit);
}

void ProcessLink::run() noexcept try {
  if (connect()) converse();
  if (leaving_) return;
  tell_end(wait_for_end());
} catch (const std::exception& e) {
  logger.error("the link to the driver host {}: {}", socket_name_, e.what());
  if (leaving_) return;
  killed_ = e.what();
  process_.kill();
  tell_end({HostEnd::How::crashed, fmt::format("was ended: {}", e.what()), {}});
}

void ProcessLink::tell_end(const HostEnd& end) {
  if (options_.brokers) options_.brokers->forget(socket_name_);
  if (options_.metrics) options_.metrics->forget(name_, process_.id());
  if (!leaving_) events_.on_ended(end);
}

/// Tries until the host listens, ends, or takes too long. \return whether the link is connected.
bool ProcessLink::connect() {
  processes::Silence silence(Steady::now(), longest_connect_pause);
  while (!leaving_) {
    socket_ = processes::connect_in(options_.state_dir, socket_name_);
    if (socket_) return prove();
    if (processes::wait_readable(process_.ended(), connect_pause)) return false;  // the host has ended
    if (overdue({})) return false;
    if (silence.measure(Steady::now()) < options_.hang_limit) continue;
    killed_ = fmt::format("hung: it did not listen within {} ms", options_.hang_limit.count());
    process_.kill();
    return false;
  }
  return false;
}

/// \return false if the host is gone. \throws config::Error if it is not the host that listens.
bool ProcessLink::prove() {
  const int peer = processes::peer_process(socket_);
  if (peer != process_.id())
    throw config::Error(fmt::format("process {} has its socket, which is {}", peer, process_.id()));
  return processes::send_all(socket_, encode(protocol::ProveGateway{proof_}));
}

void ProcessLink::converse() {
  processes::Silence silence(Steady::now(), std::min(2 * options_.ping_period, options_.hang_limit / 2));
  while (!leaving_) {
    std::array<pollfd, 3> on{{{socket_.get(), POLLIN, 0}, {waker_.get(), POLLIN, 0}, {process_.ended(), POLLIN, 0}}};
    poll(on.data(), on.size(), static_cast<int>(time_to_wait().count()));
    if (leaving_) return;
    if (on[1].revents != 0) waker_.clear();
    if (!send_waiting()) return;
    if (on[0].revents != 0) {
      if (!receive()) return;
      silence.heard();
    }
    if (on[0].revents == 0 && on[2].revents != 0) return;  // the host has ended and nothing is left to read
    ping();
    if (overdue(silence.measure(Steady::now()))) return;
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
    const config::MutexLock lock(mutex_);
    now.swap(waiting_);
  }
  return std::all_of(now.begin(), now.end(), [&](const auto& bytes) { return processes::send_all(socket_, bytes); });
}

bool ProcessLink::receive() {
  const auto bytes = processes::receive_some(socket_);
  if (!bytes) return false;
  frames_.feed(bytes->data(), bytes->size());
  while (const auto body = frames_.next()) {
    std::visit([this](const auto& report) { heard(report); }, protocol::decode_report(*body));
  }
  return true;
}

void ProcessLink::heard(const protocol::HostHello& hello) {
  {
    const config::MutexLock lock(mutex_);
    answers_ = hello.answers;
  }
  for (const auto& instance : hello.instances) {
    name_after(instance.status.instance);
    events_.on_status(instance.status);
  }
}

void ProcessLink::heard(const protocol::StatusChange& change) {
  name_after(change.status.instance);
  events_.on_status(change.status);
}

void ProcessLink::heard(const protocol::PluginRefused& refused) {
  refused_ = refused.reason;
  shutdown(death_limit);
}

void ProcessLink::heard(const protocol::Pong& pong) {
  if (options_.brokers) options_.brokers->put(socket_name_, pong.brokers, Steady::now());
  judge(pong.stalls);
}

void ProcessLink::heard(const protocol::HostSamples& metrics) {
  show_metrics(metrics.samples);
}

void ProcessLink::heard(const protocol::PassMessage& message) {
  if (events_.on_pass) events_.on_pass(message.passed);
}

void ProcessLink::heard(const protocol::AnswerMessage& answer) {
  if (events_.on_answer) events_.on_answer(answer.number, answer.answer);
}

void ProcessLink::heard(const protocol::ChannelAnswer& answer) {
  if (events_.on_told) events_.on_told(answer.number, answer.look);
}

void ProcessLink::name_after(const discovery::InstanceId& instance) {
  if (!order_.isolated || name_.find('#') != std::string::npos) return;
  if (options_.metrics) options_.metrics->forget(name_, process_.id());
  name_ += "#" + instance;
}

void ProcessLink::judge(const std::vector<Stall>& stalls) {
  for (const auto& stall : stalls) {
    const auto limit = stall.limit.value_or(stall.own_thread ? options_.own_thread_hang_limit : options_.hang_limit);
    if (limit.count() == 0 || stall.time < limit) continue;
    killed_ = fmt::format("hung: a callback of {} has been running for {} ms",
                          stall.instance.empty() ? "a driver" : stall.instance.str(), stall.time.count());
    culprit_ = stall.instance;
    process_.kill();
    return;
  }
}

void ProcessLink::ping() {
  const auto now = Steady::now();
  if (now < next_ping_) return;
  next_ping_ = now + options_.ping_period;
  send(protocol::Ping{1});
  ask_for_metrics(now);
  if (keep_log_) keep_log_();
  const std::string excess = vitals_.examine(now);
  if (excess.empty() || !killed_.empty()) return;
  killed_ = excess;
  process_.kill();
}

void ProcessLink::ask_for_metrics(Instant now) {
  if (!options_.metrics || now < next_metrics_) return;
  next_metrics_ = now + options_.metrics_period;
  send(protocol::AskForSamples{});
}

void ProcessLink::show_metrics(std::vector<config::Sample> samples) {
  if (!options_.metrics) return;
  config::Sample memory;
  memory.name = "iotcloud_host_memory_bytes";
  memory.help = "Memory that a driver host takes";
  memory.kind = config::Sample::Kind::gauge;
  memory.value = static_cast<double>(vitals_.memory_bytes());
  samples.push_back(std::move(memory));
  options_.metrics->put(name_, process_.id(), std::move(samples));
}

/// Kills the host if it has not answered for too long or did not shut down in time. \return whether it was killed.
bool ProcessLink::overdue(std::chrono::nanoseconds silent) {
  config::UniqueLock lock(mutex_);
  const bool shutting_down = shutting_down_;
  if (shutting_down && Steady::now() > shutdown_deadline_) {
    killed_ = "did not shut down in time and was killed";
  } else if (!shutting_down && silent > options_.hang_limit) {
    killed_ = fmt::format("hung: no answer for {} ms", options_.hang_limit.count());
  } else {
    return false;
  }
  lock.unlock();
  process_.kill();
  return true;
}

HostEnd ProcessLink::wait_for_end() {
  if (!process_.wait(death_limit)) {
    if (killed_.empty()) killed_ = "closed its connection and went on; it was killed";
    process_.kill();
    process_.wait(death_limit);
  }
  const std::string how = process_.how_it_ended();
  unlink((options_.state_dir + "/" + socket_name_).c_str());
  const config::MutexLock lock(mutex_);
  if (!refused_.empty()) return {HostEnd::How::refused, refused_, {}};
  if (shutting_down_) return {HostEnd::How::stopped, killed_, {}};
  if (!killed_.empty()) return {HostEnd::How::crashed, killed_, culprit_};
  return {HostEnd::How::crashed, how, {}};
}

}  // namespace iotcloud::gateway
