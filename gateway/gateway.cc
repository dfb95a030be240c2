#include <algorithm>
#include <atomic>
#include <future>
#include <optional>
#include <set>

#include <fmt/format.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/membership.h>
#include <iotcloud/gateway/order_audit.h>
#include <iotcloud/gateway/order_feed.h>
#include <iotcloud/gateway/provisioning/provisioner.h>

namespace iotcloud::gateway {

using std::chrono::milliseconds;

namespace {

constexpr milliseconds taken_pause{250};
constexpr milliseconds cleaning_pause{10'000};
constexpr milliseconds record_share_of_stop{500};
/// How long the hosts of a gateway whose place another one has may take to end.
constexpr milliseconds fencing_limit{2000};

const config::Clock& clock_of(const GatewayOptions& options) {
  return options.clock != nullptr ? *options.clock : config::system_clock();
}

discovery::GatewayRecord record_of(const GatewayOptions& options) {
  discovery::GatewayRecord record;
  record.id = options.id;
  record.host = options.host;
  record.port = options.port;
  record.tls = options.tls;
  for (const auto& broker : options.brokers) record.brokers.push_back(broker.name);
  record.since_ms = clock_of(options).wall_ms();
  return record;
}

/// What start() waits for: whether the gateway was registered, or why not. All but wait() is called on the loop.
class StartOutcome {
 public:
  /// \param refusal empty: start() returns. \return whether this is the first outcome; later ones count for nothing.
  bool tell(const std::string& refusal) {
    if (std::exchange(told_, true)) return false;
    outcome_.set_value(refusal);
    return true;
  }
  std::string wait() { return outcome_.get_future().get(); }

 private:
  std::promise<std::string> outcome_;
  bool told_ = false;
};

}  // namespace

struct Gateway::Impl {
  explicit Impl(GatewayOptions given)
      : options(std::move(given)),
        audit(options.audit ? std::make_unique<OrderAudit>(options.audit) : nullptr),
        clock(clock_of(options)),
        membership(*options.registry, options.paths,
                   {record_of(options), options.state_id, options.session_timeout, &clock}),
        loop("gateway"),
        feed(*options.registry, options.paths, options.id, loop, clock, listener(), options.order_keys,
             options.followed_file),
        instances({options.id, options.registry, options.paths, options.launcher.get(), options.brokers,
                   options.restart, &clock, options.history_file, options.session_timeout},
                  loop) {
    if (!options.provisioning) return;
    Provisioner::Options rules;
    rules.gateway = options.id;
    rules.rules = *options.provisioning;
    rules.file = options.provisioned_file;
    rules.clock = &clock;
    rules.metrics = options.metrics != nullptr ? options.metrics : &config::process_metrics();
    rules.run = [this](const auto& order, bool again) {
      if (order.properties.contains("lease")) renew_leases();
      instances.provision(order, again);
    };
    rules.end = [this](const auto& instance) { instances.forget(instance); };
    provisioner.emplace(std::move(rules));
    instances.on_found([this](const FoundReport& report) {
      provisioner->heard(report);
      provision();
    });
  }

  OrderFeed::Listener listener() {
    OrderFeed::Listener to;
    to.on_first = [this](const auto& names) { instances.ordered_at_first(names); };
    to.on_order = [this](const auto& order, std::int64_t version) {
      followed(order, version);
      provision();
    };
    to.on_gone = [this](const auto& instance) {
      provisioner ? provisioner->unsaid(instance) : instances.forget(instance);
      provision();
    };
    to.present = [this] { return instances.present(); };
    to.without_record = [this](const auto& of) { return instances.without_record(of); };
    to.on_frozen = [this] { instances.publish_adopted(); };
    if (audit) {
      to.audit_begun = [this](const auto& orders) { audit->begin(orders); };
      to.audit = [this](security::AuditEntry entry) { audit->write(std::move(entry)); };
    }
    to.on_orders_read = [this] {
      knows_registry = true;
      if (feed.frozen().empty()) begin_provisioning(instances.left_by_rules());
      write_records();
      provision();
    };
    return to;
  }

  // These functions run on the loop.
  void join(const std::shared_ptr<StartOutcome>& first);
  void joined();
  void followed(const discovery::OrderRecord& order, std::int64_t version);
  void begin_provisioning(const std::set<discovery::InstanceId>& left);
  void provision();
  void write_records();
  void renew_leases();
  void alive_changed(const std::optional<discovery::Node>& node);
  void await_return();
  /// \return whether that is new
  bool say(std::string Impl::*trouble, const std::string& why);
  void end_replaced(const std::function<void(const std::string& why)>& then);
  void stop_orders();
  void finish_stop(const std::shared_ptr<std::promise<void>>& done);

  const GatewayOptions options;
  const std::unique_ptr<OrderAudit> audit;
  const config::Clock& clock;
  Membership membership;
  bool told_taken = false;
  bool stopping = false;
  bool awaits_return = false;
  std::optional<config::Clock::Instant> confirmed;  ///< when the registry was asked that last confirmed the place
  bool knows_registry = false;                      ///< the feed has read the orders since the last connection
  bool restore_due = false;                         ///< the registry may have lost records of this gateway
  discovery::GuardPtr session_listener, alive_watch, drain_watch;
  std::optional<HandlerId> provision_timer;
  config::Clock::Instant provision_due{};

  std::atomic<bool> has_joined{false};
  config::Mutex mutex;
  bool started IOTCLOUD_GUARDED_BY(mutex) = false;
  bool stopped IOTCLOUD_GUARDED_BY(mutex) = false;
  /// Why the registry does not show that this gateway lives, in one line; empty: it does.
  std::string unregistered IOTCLOUD_GUARDED_BY(mutex) = "the gateway has not registered yet";
  /// Why records that the registry lost are not there again, in one line; empty: they are.
  std::string unrecorded IOTCLOUD_GUARDED_BY(mutex);

  EventLoop loop;  ///< after the members that callbacks on the loop use, so that it is destroyed before them
  OrderFeed feed;
  std::optional<Provisioner> provisioner;
  OrderedInstances instances;  ///< destroyed first, because its fleet posts events to the loop
};

Gateway::Gateway(GatewayOptions options) {
  check_name("gateway id", options.id);
  for (const auto& broker : options.brokers) {
    if (broker.options.urls.empty()) {
      throw config::Error(fmt::format("the broker \"{}\" has no urls; give at least one", broker.name));
    }
  }
  impl_ = std::make_unique<Impl>(std::move(options));
}

Gateway::~Gateway() {
  stop(milliseconds{5000});
  // The order matters: stop the loop, then destroy what posts to it, then the loop.
  impl_->loop.stop();
  impl_->stop_orders();
}

std::string Gateway::trouble() const {
  const std::string frozen = impl_->feed.frozen();
  if (!frozen.empty()) return fmt::format("frozen: {}; `iotcloud registry adopt {}`", frozen, impl_->options.id);
  const std::string unregistered = [this] {
    const config::MutexLock lock(impl_->mutex);
    return impl_->unregistered.empty() ? impl_->unrecorded : impl_->unregistered;
  }();
  return unregistered.empty() ? impl_->feed.refused() : unregistered;
}

void Gateway::show_trouble(const std::string& text) {
  impl_->loop.post([impl = impl_.get(), text] {
    impl->membership.set_trouble(text);
    if (impl->stopping) return;
    if (!impl->knows_registry) {  // the record is written when the registry is there
      impl->restore_due = true;
      return;
    }
    try {
      impl->membership.restore_record();
    } catch (const discovery::RegistryError& error) {
      impl->restore_due = true;
      logger.debug("the gateway's record is written when the registry answers: {}", error.what());
    }
  });
}

discovery::ChannelLook Gateway::ask(const ChannelQuestion& question, milliseconds limit) {
  auto told = std::make_shared<std::promise<discovery::ChannelLook>>();
  auto answer = told->get_future();
  impl_->loop.post([impl = impl_.get(), question, told] {
    impl->instances.ask(question, [told](discovery::ChannelLook look) { told->set_value(std::move(look)); });
  });
  if (answer.wait_for(limit) == std::future_status::ready) return answer.get();
  discovery::ChannelLook none;
  none.problem =
      fmt::format("the driver host of {} has not answered within {} ms{}", question.look.instance, limit.count(),
                  question.message ? ": the message waits for its driver, and what becomes of it is not known" : "");
  return none;
}

void Gateway::set_rules(ProvisioningRules rules) {
  if (!impl_->provisioner) return;
  impl_->loop.post([impl = impl_.get(), rules = std::move(rules)] {
    if (impl->stopping) return;
    impl->provisioner->set_rules(rules);
    impl->provision();
  });
}

bool Gateway::has_joined() const {
  return impl_->has_joined;
}

bool Gateway::follows_signed_orders() const {
  return impl_->options.order_keys != nullptr;
}

const discovery::GatewayId& Gateway::id() const {
  return impl_->options.id;
}

void Gateway::start(const std::stop_token& stop) {
  {
    const config::MutexLock lock(impl_->mutex);
    impl_->started = true;
  }
  auto first = std::make_shared<StartOutcome>();
  impl_->loop.post([impl = impl_.get(), first] {
    impl->instances.adopt();
    impl->join(first);
  });
  const std::stop_callback cut_short(stop, [impl = impl_.get(), first] {
    impl->loop.post([impl, first] { impl->stopping = first->tell("") || impl->stopping; });
  });
  const std::string refusal = first->wait();
  if (!refusal.empty()) throw config::Error(refusal);
}

/// \param first gets the outcome of start(): empty, or why it failed; null once start() has returned.
void Gateway::Impl::join(const std::shared_ptr<StartOutcome>& first) try {
  const auto again = [&](milliseconds pause, const std::shared_ptr<StartOutcome>& waiting) {
    loop.start_timer(pause, milliseconds{0}, [this, waiting] {
      if (!stopping) join(waiting);
    });
  };
  const auto asked = clock.now();
  switch (membership.join()) {
    case Membership::Result::joined:
      confirmed = asked;
      joined();
      if (first) first->tell("");
      return;
    case Membership::Result::away:
      if (say(&Impl::unregistered, fmt::format("the gateway is not registered yet: {}", membership.problem())))
        logger.warn("the gateway {} is not registered yet: {}; it tries on", options.id, membership.problem());
      if (first) first->tell("");
      again(options.retry_pause, nullptr);
      return;
    case Membership::Result::taken:
      break;
  }
  say(&Impl::unregistered,
      fmt::format("the gateway is not registered: its id is held by a gateway at {}", membership.holder_address()));
  if (membership.must_be_another()) {
    end_replaced([this, first](const std::string& why) {
      if (first) {
        first->tell(why);
      } else if (options.on_replaced) {
        options.on_replaced(why);
      }
    });
    return;
  }
  if (!std::exchange(told_taken, true)) {
    logger.warn(
        "the id {} is held by a gateway at {}; this one waits up to {} ms, in which a dead one's place would become "
        "free. If that one is alive, give this one an id of its own (id: in its file), or stop the other",
        options.id, membership.holder_address(), membership.patience().count());
  }
  again(taken_pause, first);
} catch (const std::exception& e) {
  logger.error("the gateway cannot register: {}", e.what());
  if (first) first->tell(e.what());
}

/// Notes one of the two troubles with the registry that Gateway::trouble() tells. \param why empty: it is over
bool Gateway::Impl::say(std::string Impl::*trouble, const std::string& why) {
  const config::MutexLock lock(mutex);
  return std::exchange(this->*trouble, why) != why;
}

void Gateway::Impl::joined() {
  has_joined = true;
  say(&Impl::unregistered, "");
  logger.info("the gateway {} is registered", options.id);
  // The callbacks run on the registry's dispatcher thread, so they only post to the loop.
  session_listener = options.registry->on_session([this](discovery::SessionState state) {
    if (state == discovery::SessionState::connected) return;
    loop.post([this, state] {
      knows_registry = false;
      instances.pause_records();
      restore_due = restore_due || state == discovery::SessionState::expired;
    });
  });
  alive_watch = options.registry->watch_node(
      options.paths.gateway_alive(options.id),
      [this](const std::optional<discovery::Node>& node) { loop.post([this, node] { alive_changed(node); }); });
  loop.start_timer(options.retry_pause, options.retry_pause, [this] {
    write_records();
    if (instances.leased()) renew_leases();
  });
  if (provisioner) {
    drain_watch = options.registry->watch_node(options.paths.gateway_draining(options.id),
                                               [this](const std::optional<discovery::Node>& node) {
                                                 loop.post([this, draining = node.has_value()] {
                                                   provisioner->set_draining(draining);
                                                   provision();
                                                 });
                                               });
  }
  if (confirmed) instances.renew(*confirmed);
  if (options.plugins) {
    loop.start_timer(cleaning_pause, cleaning_pause, [this] {
      if (const auto named = instances.plugins_named()) options.plugins->clean(*named);
    });
  }
  feed.start();
}

void Gateway::Impl::followed(const discovery::OrderRecord& order, std::int64_t version) {
  if (!order.made_by.empty()) {
    if (provisioner) provisioner->said(order);
    return;
  }
  if (provisioner) provisioner->ordered(order.instance);
  if (order.properties.contains("lease")) renew_leases();
  instances.follow(order, version);
}

/// \param left what rules of an earlier run of the gateway made, and runs on
void Gateway::Impl::begin_provisioning(const std::set<discovery::InstanceId>& left) {
  if (provisioner) return provisioner->begin(left);
  for (const auto& instance : left) instances.forget(instance);  // there are no rules any more
}

/// Does what the rules have to do now, and comes back when more is due.
void Gateway::Impl::provision() {
  if (!provisioner || stopping) return;
  const auto next = provisioner->work();
  if (!next) return;
  const auto due = clock.now() + *next;
  if (provision_timer && provision_due <= due) return;
  if (provision_timer) loop.stop_handler(*provision_timer);
  provision_due = due;
  provision_timer = loop.start_timer(*next, milliseconds{0}, [this] {
    provision_timer.reset();
    provision();
  });
}

/// Writes the records, but not before the feed knows whether this is the registry that it knew: until then the feed
/// needs the records in it to find that out.
void Gateway::Impl::write_records() {
  if (stopping || !knows_registry) return;
  try {
    if (restore_due) {
      // What another gateway wrote in this one's place is not to be put back: the orders may be read before the watch
      // of the place tells.
      const auto alive = options.registry->get(options.paths.gateway_alive(options.id));
      if (membership.holder(alive) == Membership::Holder::another) return alive_changed(alive);
      membership.restore_record();
      instances.restore_records();
      restore_due = false;
      say(&Impl::unrecorded, "");
    }
    instances.resume_records();
  } catch (const discovery::RegistryError& e) {
    logger.debug("the records are restored when the registry answers: {}", e.what());
    say(&Impl::unrecorded, fmt::format("the gateway's records are not in the registry: {}", e.what()));
  }
}

/// Asks whether this gateway still has its place. Only a confirmation moves the leases on, and only to the time before
/// the question, so that a late answer renews nothing. The hosts are told in any case: those inside this process look
/// at their leases then.
void Gateway::Impl::renew_leases() {
  if (stopping) return;
  const auto asked = clock.now();
  try {
    if (options.registry->session() == discovery::SessionState::connected &&
        membership.holder(options.registry->get(options.paths.gateway_alive(options.id))) == Membership::Holder::self) {
      confirmed = asked;
    }
  } catch (const discovery::RegistryError& e) {
    logger.debug("the leases are not renewed: {}", e.what());
  }
  if (confirmed) instances.renew(*confirmed);
}

void Gateway::Impl::alive_changed(const std::optional<discovery::Node>& node) {
  if (stopping) return;
  switch (membership.holder(node)) {
    case Membership::Holder::another:
      end_replaced([this](const std::string& why) {
        if (options.on_replaced) options.on_replaced(why);
      });
      return;
    case Membership::Holder::nobody:
      say(&Impl::unregistered,
          fmt::format("the gateway is not registered any more: its node {} is gone; it makes it again",
                      options.paths.gateway_alive(options.id)));
      await_return();
      return;
    case Membership::Holder::self:
      say(&Impl::unregistered, "");
      break;
  }
  if (restore_due) feed.read_orders();
}

/// After the end of a session the node returns by itself. When somebody removed it, it does not.
void Gateway::Impl::await_return() {
  if (std::exchange(awaits_return, true)) return;
  loop.start_timer(options.retry_pause, milliseconds{0}, [this] {
    awaits_return = false;
    if (stopping) return;
    if (options.registry->session() != discovery::SessionState::connected) {
      await_return();  // when the same session is connected again, nothing tells whether the node is there
      return;
    }
    try {
      if (options.registry->get(options.paths.gateway_alive(options.id))) return;
      restore_due = true;  // who removed this node may have removed records, too
      membership.hold_again();
    } catch (const discovery::RegistryError& e) {
      logger.debug("whether this gateway shows that it lives is not known: {}", e.what());
      await_return();
    }
  });
}

/// Ends the driver hosts, because another process has this gateway's place.
void Gateway::Impl::end_replaced(const std::function<void(const std::string& why)>& then) {
  const std::string why =
      fmt::format("another gateway with the id \"{}\" is alive ({}); give this one an id of its own, or stop the other",
                  options.id, membership.holder_address());
  logger.error("{}; this gateway ends, and its driver hosts with it", why);
  say(&Impl::unregistered, why);
  stop_orders();
  instances.abandon(fencing_limit, [then, why] { then(why); });
}

void Gateway::stop(milliseconds limit) {
  {
    const config::MutexLock lock(impl_->mutex);
    if (!impl_->started || impl_->stopped) return;
    impl_->stopped = true;
  }
  const auto deadline = std::chrono::steady_clock::now() + limit;
  auto done = std::make_shared<std::promise<void>>();
  auto over = done->get_future();
  const auto for_hosts = std::max(limit - record_share_of_stop, limit / 2);
  impl_->loop.post([impl = impl_.get(), for_hosts, done] {
    impl->stop_orders();
    impl->instances.stop(for_hosts, [impl, done] { impl->finish_stop(done); });
  });
  if (over.wait_until(deadline) != std::future_status::ready) {
    logger.error("not everything stopped within {} ms", limit.count());
  }
}

void Gateway::Impl::stop_orders() {
  stopping = true;
  feed.stop();
  session_listener.reset();
  alive_watch.reset();
  drain_watch.reset();
}

void Gateway::Impl::finish_stop(const std::shared_ptr<std::promise<void>>& done) {
  membership.leave();
  logger.info("the gateway {} has stopped", options.id);
  done->set_value();
}

processes::PluginStore* Gateway::plugins() const {
  return impl_->options.plugins.get();
}

std::vector<discovery::KnownPlugin> Gateway::known_plugins() const {
  std::map<std::string, std::string> names;
  for (const auto& record : instances()) {
    if (!record.sha256.empty()) names[record.sha256] = record.plugin;
  }
  return impl_->options.launcher->plugins(names);
}

std::int64_t Gateway::epoch() const {
  return impl_->feed.epoch();
}

std::vector<discovery::DriverRecord> Gateway::instances() const {
  return impl_->instances.all();
}

std::vector<StateChange> Gateway::changes(const discovery::InstanceId& instance) const {
  return impl_->instances.changes().of(instance);
}

Gateway::AwaitedRecord Gateway::wait_for(const discovery::InstanceId& instance, const Condition& condition,
                                         milliseconds limit, std::int64_t order_version) const {
  return impl_->instances.wait_for(instance, condition, limit, order_version);
}

}  // namespace iotcloud::gateway
