#include <algorithm>
#include <exception>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/drivers/channel_names.h>
#include <iotcloud/gateway/host/channel_looks.h>
#include <iotcloud/gateway/host/driver_instance.h>
#include <iotcloud/gateway/host/logger.h>
#include <iotcloud/gateway/host/outgoing_channel.h>

namespace iotcloud::gateway {

using discovery::DriverState;

namespace {

constexpr const char* hang_limit_property = "hang_limit";

std::uint64_t next_number() {
  static std::atomic<std::uint64_t> last{0};
  return ++last;
}

/// The property `hang_limit`; nullopt if it is missing or invalid (then open_now() refuses it).
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

struct DriverInstance::Incoming {
  PlannedChannel plan;
  std::shared_ptr<brokers::Broker> broker;  ///< declared before the members that use it
  std::shared_ptr<ChannelQueue> queue;
  config::Counter& received;
  config::Counter& failed;  ///< messages that the driver failed on
  std::shared_ptr<ChannelLooks> looks;
  std::uint64_t delivered = 0;                          ///< the key of the message that was delivered last
  std::unique_ptr<brokers::Subscription> subscription;  ///< null: the channel uses a subscription that instances share
};

DriverInstance::DriverInstance(std::shared_ptr<HostEnvironment> environment, InstanceSpec spec,
                               std::shared_ptr<EventLoop> loop)
    : environment_(std::move(environment)),
      id_(spec.order.instance),
      properties_(config::with_defaults(spec.order.properties, environment_->plugin->declaration())),
      loop_(std::move(loop)),
      number_(next_number()),
      hang_limit_(hang_limit_of(properties_)),
      spec_(std::move(spec)),
      channels_(*environment_, id_) {
  status_.instance = id_;
  status_.driver =
      spec_.order.driver.empty() ? discovery::DriverName(environment_->plugin->name()) : spec_.order.driver;
  status_.since_ms = environment_->clock->wall_ms();
}

DriverInstance::~DriverInstance() = default;

InstanceSpec DriverInstance::spec() const {
  const config::MutexLock lock(mutex_);
  return spec_;
}

InstanceStatus DriverInstance::status() const {
  const config::MutexLock lock(mutex_);
  return status_;
}

void DriverInstance::report(DriverState state, const std::string& reason) {
  InstanceStatus status;
  {
    const config::MutexLock lock(mutex_);
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

void DriverInstance::set_active(bool active) {
  const config::MutexLock lock(mutex_);
  spec_.order.active = active;
}

bool DriverInstance::call(const char* what, const std::function<void(std::string&)>& driver_call) {
  std::string error;
  const EventLoop::Serving serving(*loop_, number_);
  driver_call(error);
  if (!error.empty()) fail(fmt::format("{}: {}", what, error));
  return error.empty() && !failing_;
}

// Commands. Each one posts its work to the event thread, which runs them in the order given.

void DriverInstance::open() {
  loop_->post([self = shared_from_this()] { self->open_now(); });
}

void DriverInstance::activate() {
  set_active(true);
  loop_->post([self = shared_from_this()] { self->activate_now(); });
}

void DriverInstance::deactivate() {
  set_active(false);
  loop_->post([self = shared_from_this()] { self->deactivate_now(); });
}

void DriverInstance::remove(Removal removal) {
  loop_->post([self = shared_from_this(), removal] {
    // A host that ends removes what is being removed, too. The first removal's report is the instance's last.
    if (std::exchange(self->removed_, true)) return;
    self->undeployed_ = removal == Removal::undeployed;
    self->close_now(DriverState::undeployed, "");
  });
}

void DriverInstance::suspend(const std::string& reason, std::function<void()> closed) {
  loop_->post([self = shared_from_this(), reason, closed = std::move(closed)]() mutable {
    if (self->closed_ || self->failing_) return;
    self->close_now(DriverState::inactive, reason, std::move(closed));
  });
}

/// Runs a part of the opening on the event thread. What it throws fails the instance.
void DriverInstance::attempt(const std::function<void()>& part) {
  try {
    part();
  } catch (const std::exception& e) {
    fail(e.what());
  }
}

void DriverInstance::open_now() {
  report(DriverState::starting, "");
  attempt([this] {
    check_properties();
    check_hang_limit(properties_);
    shell_ = environment_->plugin->descriptor().create();
    if (shell_ == nullptr) {
      fail("the driver's constructor threw");
      return;
    }
    open_channels(status().driver);
  });
}

/// Compares what was ordered with what the driver declares. \throws config::Error that names all that is wrong
void DriverInstance::check_properties() const {
  const auto problems = config::problems_of(properties_, environment_->plugin->declaration());
  if (!problems.empty()) throw config::Error(config::text_of(problems));
}

void DriverInstance::open_channels(const discovery::DriverName& driver) {
  std::vector<drivers::ChannelSpec> wanted;
  if (!call("channels", [&](std::string& error) { wanted = shell_->channels(properties_, error); })) return;
  const auto planned = plan_channels(environment_->gateway, driver, spec(), std::move(wanted));
  const auto is_incoming = [](const PlannedChannel& channel) {
    return channel.spec.direction == drivers::Direction::in;
  };
  if (std::any_of(planned.begin(), planned.end(), is_incoming)) round_trips_ = std::make_unique<RoundTrips>();
  uses_spools_ = std::any_of(planned.begin(), planned.end(), [](const PlannedChannel& channel) {
    return channel.spec.direction == drivers::Direction::out && channel.spec.when_full == drivers::WhenFull::spool;
  });
  if (!uses_spools_) {
    open_all_outgoing(planned);
    open_driver(planned);
    return;
  }
  // A spool's folder is locked and read first, so the event thread goes on with other instances meanwhile.
  environment_->spools().post([self = shared_from_this(), planned] {
    try {
      self->open_all_outgoing(planned);
    } catch (const std::exception& e) {
      self->fail(e.what());
      return;
    }
    self->loop_->post([self, planned] {
      // It may have ended meanwhile: then its end, which waits for its turn behind this opening, closes the channels.
      if (self->closed_ || self->failing_) return;
      self->attempt([&] { self->open_driver(planned); });
    });
  });
}

void DriverInstance::open_all_outgoing(const std::vector<PlannedChannel>& planned) {
  for (const auto& channel : planned) {
    if (channel.spec.direction == drivers::Direction::out) open_outgoing(channel);
  }
}

/// Opens the driver and its incoming channels, when its outgoing ones are open, and activates it if the order says so.
void DriverInstance::open_driver(const std::vector<PlannedChannel>& planned) {
  open_ = true;  // set before open(), in which the driver may publish already
  if (!call("open", [&](std::string& error) { shell_->open(*this, error); })) return;
  for (const auto& channel : planned) {
    if (channel.spec.direction == drivers::Direction::in) open_incoming(channel);
  }
  {
    const config::MutexLock lock(mutex_);
    for (const auto& channel : planned) status_.channels.push_back(channel.record);
  }
  if (failing_) return;
  if (spec().order.active) {
    activate_now();
  } else {
    report(DriverState::inactive, "");
  }
}

void DriverInstance::open_outgoing(const PlannedChannel& channel) {
  const std::string& name = channel.spec.name;
  // Runs an event's call into the driver on the event thread, if the instance is still open.
  const auto on_event_thread = [weak = weak_from_this()](std::function<void(DriverInstance&)> tell) {
    const auto self = weak.lock();
    if (!self) return;
    self->loop_->post([self, tell = std::move(tell)] {
      if (self->running()) tell(*self);
    });
  };
  OutgoingChannel::Events events;
  events.on_writable = [on_event_thread, name] {
    on_event_thread([name](DriverInstance& self) {
      self.call("on_writable", [&](std::string& error) { self.shell_->on_writable(name, error); });
    });
  };
  events.on_stored = [on_event_thread, name](std::uint64_t number) {
    on_event_thread([name, number](DriverInstance& self) {
      self.call("on_stored", [&](std::string& error) { self.shell_->on_stored(name, number, error); });
    });
  };
  auto outgoing = std::make_unique<OutgoingChannel>(*environment_, id_, channel, std::move(events));
  channels_.add_outgoing(channel, std::move(outgoing));
}

void DriverInstance::open_incoming(const PlannedChannel& channel) {
  const std::string& name = channel.spec.name;
  const config::Labels labels{{"driver", channel.record.driver}, {"channel", name}};
  config::Labels failed = labels;
  failed["reason"] = "failed";
  auto& metrics = *environment_->metrics;
  auto incoming = std::make_unique<Incoming>(
      Incoming{channel, environment_->brokers->get(channel.address, channel.broker), nullptr,
               metrics.counter("iotcloud_driver_received_total", "Messages handed to drivers", labels),
               metrics.counter("iotcloud_driver_lost_total", lost_help, failed),
               std::make_shared<ChannelLooks>(*environment_->clock), 0, nullptr});
  // The queue is closed before `incoming` goes, so the pointer is valid whenever it delivers.
  incoming->queue = std::make_shared<ChannelQueue>(
      loop_, channel.spec.keep_last,
      metrics.counter("iotcloud_driver_received_superseded_total",
                      "Messages dropped by keep_last before a driver saw them", labels),
      [weak = weak_from_this(), from = incoming.get()](brokers::Message&& message, config::Clock::Instant since) {
        const auto self = weak.lock();
        return self ? self->deliver(*from, std::move(message), since) : ChannelQueue::Handled::not_taken;
      });
  // Stored before it subscribes, so that close_now() finds it even if subscribing throws.
  auto& kept = *incoming_.emplace_back(std::move(incoming));
  channels_.add_incoming(channel, kept.broker, kept.queue, kept.looks);
  if (channel.spec.shared) {
    if (environment_->isolated) {
      throw config::Error(
          fmt::format("channel \"{}\" is shared and incoming, which needs all instances in one host; deploy without "
                      "isolation and `network`, or with channel.{}.shared=false",
                      name, name));
    }
    environment_->shared_channels->join(channel, kept.broker, id_, kept.queue);
    return;
  }
  brokers::SubscriptionOptions options;
  options.priority = channel.spec.priority;
  options.keep_last = channel.spec.keep_last;
  options.original_queue = channel.original_queue;
  kept.subscription =
      kept.broker->subscribe(channel.topic, options,
                             // After close() the delivery is dropped, and goes back to the broker.
                             [queue = kept.queue, clock = environment_->clock](brokers::Delivery delivery) {
                               queue->push({std::move(delivery), clock->now()});
                             });
}

void DriverInstance::activate_now() {
  if (!running() || status().state == DriverState::active) return;
  if (status().state != DriverState::starting) report(DriverState::starting, "");
  if (call("activate", [&](std::string& error) { shell_->activate(error); })) report(DriverState::active, "");
}

void DriverInstance::deactivate_now() {
  if (!running() || status().state != DriverState::active) return;
  report(DriverState::stopping, "");
  if (call("deactivate", [&](std::string& error) { shell_->deactivate(error); })) report(DriverState::inactive, "");
}

void DriverInstance::close_now(DriverState final_state, const std::string& reason, std::function<void()> closed) {
  // Already closed: a failure during closing changes nothing.
  if (std::exchange(closed_, true) && final_state == DriverState::failed) return;
  if (final_state == DriverState::failed) failed_ = true;
  if (final_state == DriverState::undeployed && !failed_) report(DriverState::stopping, "");
  open_ = false;
  std::set<HandlerId> handlers;
  {
    const config::MutexLock lock(mutex_);
    handlers.swap(handlers_);
  }
  for (const auto id : handlers) loop_->stop_handler(id);
  close_incoming();
  close_driver();
  drain_then_report(final_state, reason, std::move(closed));
}

/// What the driver has not seen goes back to the broker, or waits for the instance's return on a shared channel.
void DriverInstance::close_incoming() {
  channels_.hide();
  for (auto& incoming : incoming_) {
    // First: an open subscription would get again at once what the closed queue gives back to the broker.
    incoming->subscription.reset();
    auto unhandled = incoming->queue->close();
    if (incoming->plan.spec.shared) {
      environment_->shared_channels->leave(incoming->plan, id_, std::move(unhandled));
    } else {
      own_queues_.push_back(std::move(incoming->plan));
    }
  }
  incoming_.clear();
}

void DriverInstance::close_driver() {
  if (shell_ == nullptr) {
    driver_gone_ = true;
    return;
  }
  std::string error;
  const EventLoop::Serving serving(*loop_, number_);
  shell_->close(error);
  if (!error.empty()) host_logger.warn("{}: close: {}", id_, error);
  environment_->plugin->descriptor().destroy(shell_);
  shell_ = nullptr;
  driver_gone_ = true;
}

void DriverInstance::drain_then_report(DriverState final_state, const std::string& reason,
                                       std::function<void()> closed) {
  // Each with its broker, which waits at its end until its server was asked: it ends with the last of them.
  std::vector<std::pair<std::shared_ptr<brokers::Broker>, brokers::Topic>> unneeded;
  if (undeployed_) {
    for (const auto& channel : std::exchange(own_queues_, {})) {
      unneeded.emplace_back(environment_->brokers->get(channel.address, channel.broker), channel.topic);
    }
  }
  auto end = [self = shared_from_this(), unneeded = std::move(unneeded), final_state, reason,
              closed = std::move(closed)]() mutable {
    self->end_outgoing(final_state, reason, std::move(unneeded), std::move(closed));
  };
  // Behind the opening of its spools, and behind the end of a failure: reports are in order.
  if (uses_spools_) {
    environment_->spools().post(std::move(end));
  } else {
    end();
  }
}

/// Runs on the thread of the spools if the instance has any, because closing one waits for the disk.
void DriverInstance::end_outgoing(DriverState final_state, const std::string& reason,
                                  std::vector<std::pair<std::shared_ptr<brokers::Broker>, brokers::Topic>> unneeded,
                                  std::function<void()> closed) {
  const auto closing = std::make_shared<OpenChannels::Outgoing>(channels_.take_outgoing());
  // A failure is reported at once; an ordered end is reported after the channels are drained.
  const bool failed = final_state == DriverState::failed;
  if (failed) {
    // Close the spools before the report, because the instance's successor opens them as soon as the failure is known.
    // They keep their messages.
    for (auto& [name, channel] : *closing) {
      if (channel->spooled()) channel->close();
    }
  }
  const auto deadline = environment_->clock->now() + environment_->drain_limit;
  // Posted before a failure's report, so that it is done before the end of a host that knows of no instance any more.
  environment_->closing->post([self = shared_from_this(), closing, unneeded = std::move(unneeded), deadline, failed,
                               final_state, reason, closed = std::move(closed)] {
    for (auto& [name, channel] : *closing) {
      const auto left = std::max(deadline - self->environment_->clock->now(), config::Clock::Instant::duration::zero());
      channel->drain(std::chrono::duration_cast<std::chrono::milliseconds>(left));
      channel->close();
    }
    closing->clear();
    if (!failed) self->report(final_state, reason);
    for (const auto& [broker, topic] : unneeded) broker->remove_queue(topic, "");
    if (closed) closed();
  });
  if (failed) report(final_state, reason);
}

ChannelQueue::Handled DriverInstance::deliver(Incoming& incoming, drivers::Message&& message,
                                              config::Clock::Instant since) {
  if (!running()) return ChannelQueue::Handled::not_taken;
  incoming.received.add();
  if (const auto took = round_trips_->came(message.time_ms, environment_->clock->now()))
    environment_->round_trips.record_ns(std::chrono::nanoseconds(*took).count());
  const auto key = ++incoming.delivered;
  const bool watched = incoming.looks->watched();
  if (watched) incoming.looks->saw(message, {key, environment_->clock->now(), since});
  const std::string& channel = incoming.plan.spec.name;
  const bool handled =
      call("on_message", [&](std::string& error) { shell_->on_message(channel, std::move(message), error); });
  if (watched) incoming.looks->ended(key, handled ? "handled" : "failed");
  if (handled) return ChannelQueue::Handled::done;
  incoming.failed.add();
  return ChannelQueue::Handled::failed;
}

// What people ask.

void DriverInstance::ask(ChannelQuestion question, const std::function<void(discovery::ChannelLook)>& done) {
  if (question.message) {
    hand(question.look.channel, std::move(*question.message), done);
    return;
  }
  discovery::ChannelLook answer;
  add_state(answer);
  channels_.look(question.look, answer);
  done(std::move(answer));
}

void DriverInstance::add_state(discovery::ChannelLook& answer) const {
  const InstanceStatus now = status();
  answer.state = to_string(now.state);
  answer.reason = now.reason;
}

void DriverInstance::each_backlog(
    const std::function<void(const discovery::ChannelRecord&, const ChannelQueue::Backlog&)>& use) const {
  channels_.each_backlog(use);
}

void DriverInstance::each_tally(
    const std::function<void(const discovery::ChannelRecord&, const ChannelTally&)>& use) const {
  channels_.each_tally(use);
}

void DriverInstance::hand(const std::string& channel, brokers::Message message,
                          const std::function<void(discovery::ChannelLook)>& done) {
  message.driver_id = id_;
  message.gateway_id = environment_->gateway;
  if (message.time_ms == 0) message.time_ms = environment_->clock->wall_ms();
  channels_.hand(channel, std::move(message), [weak = weak_from_this(), done](const std::string& problem) {
    discovery::ChannelLook answer;
    answer.problem = problem;
    if (const auto self = weak.lock()) self->add_state(answer);
    done(std::move(answer));
  });
}

// HostInterface: what the driver calls.

drivers::PublishStatus DriverInstance::publish(std::string_view channel, drivers::Message message) noexcept try {
  if (!running()) return drivers::PublishStatus::closed;
  message.driver_id = id_;
  message.gateway_id = environment_->gateway;
  if (message.time_ms == 0) message.time_ms = environment_->clock->wall_ms();
  if (round_trips_) round_trips_->sent(message.time_ms, environment_->clock->now());
  const auto time_ms = message.time_ms;
  if (const auto status = channels_.publish(channel, message)) {
    if (round_trips_ && *status != drivers::PublishStatus::accepted) round_trips_->refused(time_ms);
    return *status;
  }
  if (!running()) return drivers::PublishStatus::closed;  // close_now() has just taken the channels away
  std::vector<drivers::ChannelSpec> declared;
  for (const auto& name : channels_.outgoing_names()) declared.emplace_back().name = name;
  fail(fmt::format("publish: {}", drivers::unknown_channel(channel, drivers::Direction::out, declared)));
  return drivers::PublishStatus::closed;
} catch (const std::exception& e) {
  host_logger.error("{}: publish on {} failed: {}", id_, channel, e.what());
  return drivers::PublishStatus::closed;
}

HandlerId DriverInstance::start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                                      std::function<void()> callback) noexcept {
  const HandlerId id = loop_->new_handler();
  const bool once = period.count() == 0;
  const config::MutexLock lock(mutex_);
  if (!running()) return id;
  handlers_.insert(id);
  return loop_->start_timer(
      first, period,
      [weak = weak_from_this(), id, once, callback = std::move(callback)] {
        const auto self = weak.lock();
        if (!self || !self->running()) return;
        if (once) {
          const config::MutexLock erase_lock(self->mutex_);
          self->handlers_.erase(id);
        }
        const EventLoop::Serving serving(*self->loop_, self->number_);
        callback();
      },
      id);
}

HandlerId DriverInstance::watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept {
  const HandlerId id = loop_->new_handler();
  const config::MutexLock lock(mutex_);
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

void DriverInstance::stop_handler(HandlerId id) noexcept {
  {
    const config::MutexLock lock(mutex_);
    if (handlers_.erase(id) == 0) return;
  }
  loop_->stop_handler(id);
}

void DriverInstance::post(std::function<void()> callback) noexcept {
  loop_->post([weak = weak_from_this(), callback = std::move(callback)] {
    const auto self = weak.lock();
    if (!self || !self->running()) return;
    const EventLoop::Serving serving(*self->loop_, self->number_);
    callback();
  });
}

void DriverInstance::log(drivers::LogLevel level, std::string_view text) noexcept {
  static constexpr config::LogLevel levels[] = {config::LogLevel::debug, config::LogLevel::info, config::LogLevel::warn,
                                                config::LogLevel::error};
  const auto index = std::min<std::size_t>(static_cast<std::size_t>(level), 3);
  config::log_line(levels[index], "driver." + environment_->plugin->name(), fmt::format("{}: {}", id_, text));
}

void DriverInstance::fail(std::string_view reason) noexcept {
  if (failing_.exchange(true)) return;
  loop_->post([self = shared_from_this(), text = std::string(reason)] { self->close_now(DriverState::failed, text); });
}

void DriverInstance::update_metadata(const drivers::PropertyMap& changes) noexcept {
  {
    const config::MutexLock lock(mutex_);
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
      host_logger.warn("{}: metadata of {} bytes, or an empty key, is not published; {} bytes are the most", id_, size,
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

void DriverInstance::report_found(std::string_view key, const drivers::PropertyMap& attributes) noexcept {
  constexpr std::uint64_t logged = 100;  // one in so many: strangers decide how many there are
  std::string problem;
  std::uint64_t refused = 0;
  change_found([&](FoundThings& things) {
    problem = things.found({std::string(key), attributes});
    refused = things.refused();
  });
  if (problem.empty() || (refused != 1 && refused % logged != 0)) return;
  host_logger.warn("{}: what it found is passed over: {} ({} so far; not all are logged)", id_, problem, refused);
}

void DriverInstance::report_gone(std::string_view key) noexcept {
  change_found([&](FoundThings& things) { things.gone(key); });
}

void DriverInstance::report_sight(bool sees) noexcept {
  change_found([&](FoundThings& things) { things.sight(sees); });
}

/// Changes what this instance has found; a little later all changes until then are reported together.
void DriverInstance::change_found(const std::function<void(FoundThings&)>& change) {
  {
    const config::MutexLock lock(mutex_);
    change(found_);
    if (!found_.changed() || std::exchange(found_waits_, true)) return;
  }
  loop_->start_timer(found_pause, std::chrono::microseconds{0}, [weak = weak_from_this()] {
    if (const auto self = weak.lock()) self->report_things(false);
  });
}

void DriverInstance::tell_found() {
  loop_->post([weak = weak_from_this()] {
    if (const auto self = weak.lock()) self->report_things(true);
  });
}

/// Runs on the event thread, so that reports are in order.
void DriverInstance::report_things(bool whole) {
  std::vector<FoundReport> reports;
  {
    const config::MutexLock lock(mutex_);
    if (!whole) found_waits_ = false;
    if (closed_) return;
    if (whole || found_.changed()) reports = found_.take(id_, whole);
  }
  for (auto& report : reports) environment_->report_found(std::move(report));
}

/// Runs on the event thread, as all reports before the end do, so that an older state is never reported after a newer
/// one.
void DriverInstance::report_metadata() {
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
    const config::MutexLock lock(mutex_);
    metadata_waits_ = false;
    status = status_;
  }
  environment_->report(status);
}

}  // namespace iotcloud::gateway
