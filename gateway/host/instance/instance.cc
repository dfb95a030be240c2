#include <exception>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/gateway/host/instance/instance.h>

namespace iotcloud::gateway {

using discovery::DriverState;

namespace {

constexpr config::Logger host_log{"gateway.host"};
constexpr const char* hang_limit_property = "hang_limit";

std::uint64_t next_number() {
  static std::atomic<std::uint64_t> last{0};
  return ++last;
}

/// nullopt when there is none, or one that open_now() refuses.
std::optional<std::chrono::milliseconds> hang_limit_of(const drivers::PropertyMap& properties) {
  const auto found = properties.find(hang_limit_property);
  if (found == properties.end()) return std::nullopt;
  if (found->second == "never") return std::chrono::milliseconds{0};
  const auto limit = config::parse_duration(found->second);
  if (!limit || *limit < std::chrono::milliseconds{1}) return std::nullopt;
  return std::chrono::duration_cast<std::chrono::milliseconds>(*limit);
}

void check_hang_limit(const drivers::PropertyMap& properties) {
  const auto found = properties.find(hang_limit_property);
  if (found == properties.end() || hang_limit_of(properties)) return;
  throw config::Error(fmt::format("the property {}: \"{}\" is no time; give for example 30s, or never",
                                  hang_limit_property, found->second));
}

}  // namespace

struct Instance::Incoming {
  PlannedChannel plan;
  std::shared_ptr<brokers::Broker> broker;  ///< before what uses it
  std::shared_ptr<Inbox> inbox;
  std::unique_ptr<brokers::Subscription> subscription;  ///< null: shared with other instances
};

Instance::Instance(std::shared_ptr<HostEnvironment> environment, InstanceSpec spec, std::shared_ptr<EventLoop> loop)
    : environment_(std::move(environment)),
      id_(spec.order.instance),
      properties_(spec.order.properties),
      loop_(std::move(loop)),
      number_(next_number()),
      hang_limit_(hang_limit_of(properties_)),
      spec_(std::move(spec)) {
  status_.instance = id_;
  status_.driver = spec_.order.driver.empty() ? environment_->plugin->name() : spec_.order.driver;
  status_.since_ms = environment_->clock->wall_ms();
}

Instance::~Instance() = default;

InstanceSpec Instance::spec() const {
  const std::lock_guard lock(mutex_);
  return spec_;
}

InstanceStatus Instance::status() const {
  const std::lock_guard lock(mutex_);
  return status_;
}

void Instance::report(DriverState state, const std::string& reason) {
  InstanceStatus status;
  {
    const std::lock_guard lock(mutex_);
    status_.state = state;
    status_.reason = reason;
    status_.since_ms = environment_->clock->wall_ms();
    if (state == DriverState::failed || state == DriverState::undeployed) status_.channels.clear();
    status = status_;
  }
  const auto level = state == DriverState::failed ? config::LogLevel::error : config::LogLevel::info;
  config::log_line(
      level, "gateway.host",
      fmt::format("{} {}: {}{}{}", status.driver, id_, to_string(state), reason.empty() ? "" : ": ", reason));
  environment_->report(status);
}

void Instance::set_active(bool active) {
  const std::lock_guard lock(mutex_);
  spec_.order.active = active;
}

bool Instance::call(const char* what, const std::function<void(std::string&)>& driver_call) {
  std::string error;
  const EventLoop::Serving serving(*loop_, number_);
  driver_call(error);
  if (!error.empty()) fail(fmt::format("{}: {}", what, error));
  return error.empty() && !failing_;
}

// Commands: each runs on the event thread, in the order given.

void Instance::open() {
  loop_->post([self = shared_from_this()] { self->open_now(); });
}

void Instance::activate() {
  set_active(true);
  loop_->post([self = shared_from_this()] { self->activate_now(); });
}

void Instance::deactivate() {
  set_active(false);
  loop_->post([self = shared_from_this()] { self->deactivate_now(); });
}

void Instance::remove() {
  loop_->post([self = shared_from_this()] { self->close_now(DriverState::undeployed, ""); });
}

void Instance::open_now() {
  report(DriverState::starting, "");
  try {
    check_hang_limit(properties_);
    shell_ = environment_->plugin->descriptor().create();
    if (shell_ == nullptr) {
      fail("the driver's constructor threw");
      return;
    }
    open_channels(status().driver);
  } catch (const std::exception& e) {
    fail(e.what());
    return;
  }
  if (failing_) return;
  if (spec().order.active) {
    activate_now();
  } else {
    report(DriverState::inactive, "");
  }
}

void Instance::open_channels(const std::string& driver) {
  std::vector<drivers::ChannelSpec> wanted;
  if (!call("channels", [&](std::string& error) { wanted = shell_->channels(properties_, error); })) return;
  const auto planned = plan_channels(environment_->gateway, driver, spec(), std::move(wanted));
  for (const auto& channel : planned) {
    if (channel.spec.direction == drivers::Direction::out) open_outgoing(channel);
  }
  open_ = true;  // the driver may publish from open() on
  if (!call("open", [&](std::string& error) { shell_->open(*this, error); })) return;
  for (const auto& channel : planned) {
    if (channel.spec.direction == drivers::Direction::in) open_incoming(channel);
  }
  const std::lock_guard lock(mutex_);
  for (const auto& channel : planned) status_.channels.push_back(channel.record);
}

void Instance::open_incoming(const PlannedChannel& channel) {
  const std::string& name = channel.spec.name;
  const auto counter = [&](const char* metric, const char* help) -> config::Counter& {
    return environment_->metrics->counter(metric, help, {{"driver", channel.record.driver}, {"channel", name}});
  };
  auto incoming = std::make_unique<Incoming>();
  incoming->plan = channel;
  incoming->broker = environment_->brokers->get(channel.address, channel.broker);
  config::Counter& received = counter("iotcloud_driver_received_total", "Messages handed to drivers");
  incoming->inbox = std::make_shared<Inbox>(
      loop_, channel.spec.keep_last,
      counter("iotcloud_driver_received_superseded_total", "Messages dropped by keep_last before a driver saw them"),
      [weak = weak_from_this(), name, &received](brokers::Message message) {
        const auto self = weak.lock();
        received.add();
        return self && self->deliver(name, std::move(message));
      });
  // Before it subscribes, so that close_now finds it whatever happens.
  auto& kept = *incoming_.emplace_back(std::move(incoming));
  if (channel.spec.shared) {
    if (environment_->isolated) {
      throw config::Error(
          fmt::format("channel \"{}\" is shared and incoming, which needs all instances in one host; deploy without "
                      "isolation, or with channel.{}.shared=false",
                      name, name));
    }
    environment_->shared_inboxes->join(kept.broker, channel.topic, id_, kept.inbox);
    return;
  }
  brokers::SubscriptionOptions options;
  options.priority = channel.spec.priority;
  options.keep_last = channel.spec.keep_last;
  kept.subscription = kept.broker->subscribe(
      channel.topic, options, [inbox = kept.inbox](brokers::Delivery delivery) { inbox->push(std::move(delivery)); });
}

void Instance::activate_now() {
  if (!running() || status().state == DriverState::active) return;
  if (status().state != DriverState::starting) report(DriverState::starting, "");
  if (call("activate", [&](std::string& error) { shell_->activate(error); })) report(DriverState::active, "");
}

void Instance::deactivate_now() {
  if (!running() || status().state != DriverState::active) return;
  report(DriverState::stopping, "");
  if (call("deactivate", [&](std::string& error) { shell_->deactivate(error); })) report(DriverState::inactive, "");
}

void Instance::close_now(DriverState final_state, const std::string& reason) {
  if (std::exchange(closed_, true) && final_state == DriverState::failed) return;  // it failed while it was closing
  if (final_state == DriverState::undeployed && status().state != DriverState::failed) {
    report(DriverState::stopping, "");
  }
  open_ = false;
  std::set<HandlerId> handlers;
  {
    const std::lock_guard lock(mutex_);
    handlers.swap(handlers_);
  }
  for (const auto id : handlers) loop_->stop_handler(id);
  close_incoming();
  close_driver();
  drain_then_report(final_state, reason);
}

void Instance::close_incoming() {
  for (auto& incoming : incoming_) {
    incoming->inbox->close();
    if (!incoming->subscription) {
      environment_->shared_inboxes->leave(incoming->plan.record.broker_url, incoming->plan.topic, id_);
    }
  }
  incoming_.clear();
}

void Instance::close_driver() {
  if (shell_ == nullptr) return;
  std::string error;
  const EventLoop::Serving serving(*loop_, number_);
  shell_->close(error);
  if (!error.empty()) host_log.warn("{}: close: {}", id_, error);
  environment_->plugin->descriptor().destroy(shell_);
  shell_ = nullptr;
}

bool Instance::deliver(const std::string& channel, drivers::Message message) {
  if (!running()) return false;
  return call("on_message", [&](std::string& error) { shell_->on_message(channel, std::move(message), error); });
}

// What the driver sees.

HandlerId Instance::start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                                std::function<void()> callback) noexcept {
  const HandlerId id = loop_->new_handler();
  const bool once = period.count() == 0;
  const std::lock_guard lock(mutex_);
  if (!running()) return id;
  handlers_.insert(id);
  return loop_->start_timer(
      first, period,
      [weak = weak_from_this(), id, once, callback = std::move(callback)] {
        const auto self = weak.lock();
        if (!self || !self->running()) return;
        if (once) {
          const std::lock_guard erase_lock(self->mutex_);
          self->handlers_.erase(id);
        }
        const EventLoop::Serving serving(*self->loop_, self->number_);
        callback();
      },
      id);
}

HandlerId Instance::watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept {
  const HandlerId id = loop_->new_handler();
  const std::lock_guard lock(mutex_);
  if (!running()) return id;
  handlers_.insert(id);
  return loop_->watch_descriptor(
      descriptor, for_writing,
      [weak = weak_from_this(), callback = std::move(callback)] {
        const auto self = weak.lock();
        if (!self || !self->running()) return;
        const EventLoop::Serving serving(*self->loop_, self->number_);
        callback();
      },
      id);
}

void Instance::stop_handler(HandlerId id) noexcept {
  {
    const std::lock_guard lock(mutex_);
    if (handlers_.erase(id) == 0) return;
  }
  loop_->stop_handler(id);
}

void Instance::post(std::function<void()> callback) noexcept {
  loop_->post([weak = weak_from_this(), callback = std::move(callback)] {
    const auto self = weak.lock();
    if (!self || !self->running()) return;
    const EventLoop::Serving serving(*self->loop_, self->number_);
    callback();
  });
}

void Instance::log(drivers::LogLevel level, std::string_view text) noexcept {
  static constexpr config::LogLevel levels[] = {config::LogLevel::debug, config::LogLevel::info, config::LogLevel::warn,
                                                config::LogLevel::error};
  const auto index = std::min<std::size_t>(static_cast<std::size_t>(level), 3);
  config::log_line(levels[index], "driver." + environment_->plugin->name(), fmt::format("{}: {}", id_, text));
}

void Instance::fail(std::string_view reason) noexcept {
  if (failing_.exchange(true)) return;
  loop_->post([self = shared_from_this(), text = std::string(reason)] { self->close_now(DriverState::failed, text); });
}

void Instance::update_metadata(const drivers::PropertyMap& changes) noexcept {
  {
    const std::lock_guard lock(mutex_);
    auto metadata = status_.metadata;
    for (const auto& [key, value] : changes) {
      if (value.empty()) {
        metadata.erase(key);
      } else {
        metadata[key] = value;
      }
    }
    std::size_t size = 0;
    for (const auto& [key, value] : metadata) size += key.size() + value.size();
    if (metadata.contains("") || size > most_metadata) {
      host_log.warn("{}: metadata of {} bytes, or an empty key, is not published; {} bytes are the most", id_, size,
                    most_metadata);
      return;
    }
    if (metadata == status_.metadata) return;
    status_.metadata = std::move(metadata);
    if (std::exchange(metadata_waits_, true)) return;
  }
  loop_->post([weak = weak_from_this()] {
    if (const auto self = weak.lock()) self->report_metadata();
  });
}

/// On the event thread, as all that is reported before the end: so that no older state is told after a newer one.
void Instance::report_metadata() {
  if (closed_) return;
  const auto now = environment_->clock->now();
  if (metadata_told_ && now - *metadata_told_ < metadata_pause) {
    const auto rest = std::chrono::ceil<std::chrono::microseconds>(metadata_pause - (now - *metadata_told_));
    loop_->start_timer(rest, std::chrono::microseconds{0}, [weak = weak_from_this()] {
      if (const auto self = weak.lock()) self->report_metadata();
    });
    return;
  }
  metadata_told_ = now;
  InstanceStatus status;
  {
    const std::lock_guard lock(mutex_);
    metadata_waits_ = false;
    status = status_;
  }
  environment_->report(status);
}

}  // namespace iotcloud::gateway
