#include <algorithm>
#include <variant>

#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/gateway/fleet/process_link.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

using std::chrono::milliseconds;
using Steady = std::chrono::steady_clock;

namespace {

/// For a host that cannot serve to end by itself.
constexpr milliseconds end_limit{5000};

/// The plugin's name, with part of its SHA-256 if it was uploaded, because two versions may run at once.
std::string name_in_metrics(const HostOrder& order) {
  const std::string name = order.plugin.substr(0, order.plugin.rfind('.'));
  return order.sha256.empty() ? name : name + "@" + security::short_sha256(order.sha256);
}

}  // namespace

ProcessLink::ProcessLink(const ProcessLauncher::Options& options, const HostOrder& order, std::string socket_name,
                         const std::string& proof, processes::ChildProcess process, HostEvents events,
                         std::function<void()> keep_log, std::shared_ptr<const BrokerFiles> files)
    : options_(options),
      order_(order),
      socket_name_(std::move(socket_name)),
      events_(std::move(events)),
      keep_log_(std::move(keep_log)),
      files_(std::move(files)),
      next_metrics_(Steady::now()),
      name_(name_in_metrics(order)),
      watch_({options_.state_dir, socket_name_, options_.ping_period, options_.hang_limit, milliseconds{0},
              options_.limits, encode(protocol::ProveGateway{proof})},
             std::move(process),
             {[this](const std::string& body) {
                std::visit([this](const auto& report) { heard(report); }, protocol::decode_report(body));
              },
              [this] { ping(); }, [this](const processes::WatchedEnd& end) { ended(end); }}) {}

void ProcessLink::send(const protocol::HostCommand& command) {
  watch_.send(encode(command));
}

void ProcessLink::create(const InstanceSpec& spec) {
  send(protocol::CreateInstance{files_ ? files_->with_copies(spec) : spec});
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
    watch_.send(std::move(bytes));
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
    watch_.send(std::move(bytes));
  } else if (events_.on_told) {
    discovery::ChannelLook look;
    look.problem = problem;
    events_.on_told(number, std::move(look));
  }
}

void ProcessLink::shutdown(milliseconds limit) {
  watch_.stop(encode(protocol::ShutDown{std::max(milliseconds{1}, limit)}), limit);
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
  shutdown(end_limit);
}

void ProcessLink::heard(const protocol::Pong& pong) {
  if (options_.brokers) options_.brokers->put(socket_name_, pong.brokers, Steady::now());
  if (options_.troubles)
    options_.troubles->put(socket_name_, pong.stalls, pong.losing, config::system_clock().wall_ms());
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

void ProcessLink::heard(const protocol::FoundMessage& found) {
  if (events_.on_found) events_.on_found(found.report);
}

void ProcessLink::name_after(const discovery::InstanceId& instance) {
  if (!order_.isolated || name_.find('#') != std::string::npos) return;
  if (options_.metrics) options_.metrics->forget(name_, watch_.process());
  name_ += "#" + instance;
}

void ProcessLink::judge(const std::vector<Stall>& stalls) {
  for (const auto& stall : stalls) {
    const auto limit = stall.limit.value_or(stall.own_thread ? options_.own_thread_hang_limit : options_.hang_limit);
    if (limit.count() == 0 || stall.time < limit) continue;
    const std::string name = stall.instance.empty() ? "a driver" : stall.instance.str();
    if (watch_.kill(fmt::format("hung: a callback of {} has been running for {} ms", name, stall.time.count())))
      culprit_ = stall.instance;
    return;
  }
}

void ProcessLink::ping() {
  send(protocol::Ping{1});
  ask_for_metrics(Steady::now());
  if (keep_log_) keep_log_();
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
  memory.value = static_cast<double>(watch_.memory_bytes());
  samples.push_back(std::move(memory));
  options_.metrics->put(name_, watch_.process(), std::move(samples));
}

void ProcessLink::ended(const processes::WatchedEnd& end) {
  const std::string socket = options_.state_dir + "/" + socket_name_;
  unlink(socket.c_str());
  unlink((socket + std::string(network_suffix)).c_str());
  if (options_.brokers) options_.brokers->forget(socket_name_);
  if (options_.troubles) options_.troubles->forget(socket_name_);
  if (options_.metrics) options_.metrics->forget(name_, watch_.process());
  if (!refused_.empty()) {
    events_.on_ended({HostEnd::How::refused, refused_, {}});
  } else if (end.told) {
    events_.on_ended({HostEnd::How::stopped, end.killed, {}});
  } else if (!end.killed.empty()) {
    events_.on_ended({HostEnd::How::crashed, end.killed, culprit_});
  } else {
    events_.on_ended({HostEnd::How::crashed, end.how, {}});
  }
}

}  // namespace iotcloud::gateway
