#include <exception>
#include <optional>
#include <thread>

#include <fmt/format.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/fleet/in_process_launcher.h>

namespace iotcloud::gateway {

namespace {

/// The events of a link, until the link goes: threads that a stuck driver makes a host leave behind outlive it. Thread
/// safe.
class OpenEvents {
 public:
  explicit OpenEvents(HostEvents events) : events_(std::move(events)) {}

  /// \return what `tell` returns; false, without a call, once the link is gone
  template <typename Tell>
  bool with(const Tell& tell) {
    {
      const config::MutexLock lock(mutex_);
      if (closed_) return false;
      ++running_;
    }
    const Leaving leaving{*this};
    return tell(events_);
  }
  /// When it has returned, no event function runs or will run.
  void close() {
    const config::MutexLock lock(mutex_);
    closed_ = true;
    changed_.wait(mutex_, [this] {
      mutex_.assert_held();
      return running_ == 0;
    });
  }

 private:
  struct Leaving {
    OpenEvents& events;
    ~Leaving() {
      const config::MutexLock lock(events.mutex_);
      --events.running_;
      events.changed_.notify_all();
    }
  };

  const HostEvents events_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  int running_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  bool closed_ IOTCLOUD_GUARDED_BY(mutex_) = false;
};

class InProcessLink final : public HostLink {
 public:
  InProcessLink(DriverHost::Options options, std::shared_ptr<const Plugin> plugin, HostEvents events)
      : events_(std::make_shared<OpenEvents>(std::move(events))),
        host_(passing(std::move(options)), std::move(plugin), [events = events_](const InstanceStatus& status) {
          events->with([&](const HostEvents& of) {
            of.on_status(status);
            return true;
          });
        }) {}
  ~InProcessLink() override { events_->close(); }
  InProcessLink(const InProcessLink&) = delete;
  InProcessLink& operator=(const InProcessLink&) = delete;

  void create(const InstanceSpec& spec) override { host_.create(spec); }
  void activate(const discovery::InstanceId& instance) override { host_.activate(instance); }
  void deactivate(const discovery::InstanceId& instance) override { host_.deactivate(instance); }
  void remove(const discovery::InstanceId& instance, Removal removal) override { host_.remove(instance, removal); }
  void deliver(const PassedMessage& passed) override { host_.deliver(passed); }
  void answer(std::int64_t number, PassAnswer answer) override { host_.answered(number, answer); }
  void ask(std::int64_t number, const ChannelQuestion& question) override {
    host_.ask(question, [events = events_, number](const discovery::ChannelLook& look) {
      events->with([&](const HostEvents& of) {
        if (of.on_told) of.on_told(number, look);
        return true;
      });
    });
  }
  void renew(config::Clock::Instant confirmed) override {
    host_.renew(confirmed);
    host_.enforce_leases();
  }
  void shutdown(std::chrono::milliseconds limit) override {
    if (stopper_.joinable()) return;
    stopper_ = std::jthread([this, limit] {
      HostEnd end;
      if (!host_.stop(limit)) end.reason = host_.left_behind();
      events_->with([&](const HostEvents& of) {
        of.on_ended(end);
        return true;
      });
    });
  }

 private:
  DriverHost::Options passing(DriverHost::Options options) const {
    options.passing.pass = [events = events_](const PassedMessage& message) -> std::optional<NotPassed> {
      const bool passed = events->with([&](const HostEvents& of) {
        if (of.on_pass) of.on_pass(message);
        return static_cast<bool>(of.on_pass);
      });
      if (passed) return std::nullopt;
      return NotPassed::gateway_away;
    };
    options.on_found = [events = events_](FoundReport report) {
      events->with([&](const HostEvents& of) {
        if (of.on_found) of.on_found(std::move(report));
        return true;
      });
    };
    options.passing.answer = [events = events_](std::int64_t number, PassAnswer answer) {
      events->with([&](const HostEvents& of) {
        if (of.on_answer) of.on_answer(number, answer);
        return true;
      });
    };
    return options;
  }

  const std::shared_ptr<OpenEvents> events_;
  DriverHost host_;
  std::jthread stopper_;  ///< last, so that it is joined before the other members are destroyed
};

}  // namespace

std::unique_ptr<HostLink> InProcessLauncher::launch(const HostOrder& order, HostEvents events) {
  std::shared_ptr<const Plugin> plugin;
  try {
    check_plugin_file_name(order.plugin);
    if (!order.sha256.empty())
      throw config::Error(order.plugin + " was sent, and a gateway inside a process keeps no plugins that are sent");
    if (order.network) {
      throw config::Error(
          "its property `network` restricts a process, and here drivers have none of their own: leave the property "
          "out");
    }
    const auto linked_in = options_.linked_in.find(order.plugin);
    plugin = linked_in != options_.linked_in.end() ? Plugin::wrap(*linked_in->second, order.plugin)
                                                   : Plugin::load(options_.plugin_dir + "/" + order.plugin);
  } catch (const std::exception& e) {
    events.on_ended({HostEnd::How::refused, e.what(), {}});
    return link_to_nothing();
  }
  DriverHost::Options host;
  host.gateway = order.gateway;
  host.isolated = order.isolated;
  host.state_folder = options_.state_dir;
  host.clock = options_.clock;
  host.metrics = options_.metrics;
  return std::make_unique<InProcessLink>(std::move(host), std::move(plugin), std::move(events));
}

std::unique_ptr<HostLink> InProcessLauncher::adopt(const RunningHost& host, HostEvents events) {
  return launch(host.order, std::move(events));  // never called: running() returns no hosts
}

}  // namespace iotcloud::gateway
