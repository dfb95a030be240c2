#include <algorithm>
#include <future>
#include <mutex>
#include <set>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/registration/membership.h>
#include <iotcloud/gateway/registration/order_feed.h>

namespace iotcloud::gateway {

using std::chrono::milliseconds;

namespace {

constexpr config::Logger log{"gateway"};
constexpr milliseconds retry_pause{1000};
constexpr milliseconds taken_pause{250};
constexpr milliseconds cleaning_pause{10'000};
constexpr milliseconds record_share_of_stop{500};

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

}  // namespace

struct Gateway::Impl {
  explicit Impl(GatewayOptions given)
      : options(std::move(given)),
        clock(clock_of(options)),
        membership(*options.registry, options.paths,
                   {record_of(options), options.state_id, options.session_timeout, &clock}),
        loop("gateway"),
        feed(*options.registry, options.paths, options.id, loop,
             {[this](const std::set<std::string>& names) { instances.ordered_at_first(names); },
              [this](const discovery::OrderRecord& order, std::int64_t version) { instances.follow(order, version); },
              [this](const std::string& instance) { instances.forget(instance); }}),
        instances({options.id, options.registry, options.paths, options.launcher.get(), options.brokers,
                   options.restart, &clock, options.history_file},
                  loop) {}

  // Everything below runs on the loop unless it says otherwise.
  void join(const std::shared_ptr<std::promise<std::string>>& first);
  void joined();
  void stop_orders();
  void finish_stop(const std::shared_ptr<std::promise<void>>& done);

  const GatewayOptions options;
  const config::Clock& clock;
  Membership membership;
  bool told_away = false;
  bool told_taken = false;
  bool stopping = false;
  discovery::GuardPtr session_listener;

  std::mutex mutex;
  bool started = false;  ///< guarded by mutex
  bool stopped = false;  ///< guarded by mutex

  EventLoop loop;  ///< near the end: nothing runs on it when the above dies
  OrderFeed feed;
  OrderedInstances instances;  ///< dies first: what its fleet hears is posted to the loop
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
  // First nothing runs on the loop any more, then what posts to it goes, then the loop itself.
  impl_->loop.stop();
  impl_->stop_orders();
}

const std::string& Gateway::id() const {
  return impl_->options.id;
}

void Gateway::start() {
  {
    const std::lock_guard lock(impl_->mutex);
    impl_->started = true;
  }
  auto first = std::make_shared<std::promise<std::string>>();
  auto outcome = first->get_future();
  impl_->loop.post([impl = impl_.get(), first] {
    impl->instances.adopt();
    impl->join(first);
  });
  const std::string refusal = outcome.get();
  if (!refusal.empty()) throw config::Error(refusal);
}

/// \param first told of the outcome of start(), empty or why it failed; null once the gateway counts as started.
void Gateway::Impl::join(const std::shared_ptr<std::promise<std::string>>& first) try {
  const auto again = [&](milliseconds pause, const std::shared_ptr<std::promise<std::string>>& waiting) {
    loop.start_timer(pause, milliseconds{0}, [this, waiting] {
      if (!stopping) join(waiting);
    });
  };
  switch (membership.join()) {
    case Membership::Result::joined:
      joined();
      if (first) first->set_value("");
      return;
    case Membership::Result::away:
      if (!told_away) log.warn("the registry is away; the gateway {} registers when it comes", options.id);
      told_away = true;
      if (first) first->set_value("");
      again(retry_pause, nullptr);
      return;
    case Membership::Result::taken:
      break;
  }
  if (membership.hopeless()) {
    const std::string taken = fmt::format(
        "another gateway with the id \"{}\" is alive ({}); give this one an id of its own, or stop the other",
        options.id, membership.incumbent());
    if (first) {
      first->set_value(taken);
      return;
    }
    if (!std::exchange(told_taken, true)) log.error("{}; until then this gateway follows no orders", taken);
  }
  again(taken_pause, first);
} catch (const std::exception& e) {
  log.error("the gateway cannot register: {}", e.what());
  if (first) first->set_value(e.what());
}

void Gateway::Impl::joined() {
  log.info("the gateway {} is registered", options.id);
  // It is called on the registry's dispatcher, so it only posts.
  session_listener = options.registry->on_session([this](discovery::SessionState state) {
    if (state == discovery::SessionState::connected) loop.post([this] { instances.write_records(); });
  });
  loop.start_timer(retry_pause, retry_pause, [this] { instances.write_records(); });
  if (options.plugins) {
    loop.start_timer(cleaning_pause, cleaning_pause, [this] {
      if (const auto named = instances.plugins_named()) options.plugins->clean(*named);
    });
  }
  feed.start();
}

void Gateway::stop(milliseconds limit) {
  {
    const std::lock_guard lock(impl_->mutex);
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
    log.error("not everything stopped within {} ms", limit.count());
  }
}

void Gateway::Impl::stop_orders() {
  stopping = true;
  feed.stop();
  session_listener.reset();
}

void Gateway::Impl::finish_stop(const std::shared_ptr<std::promise<void>>& done) {
  membership.leave();
  log.info("the gateway {} has stopped", options.id);
  done->set_value();
}

PluginStore* Gateway::plugins() const {
  return impl_->options.plugins.get();
}

std::int64_t Gateway::epoch() const {
  return impl_->feed.epoch();
}

std::vector<discovery::DriverRecord> Gateway::instances() const {
  return impl_->instances.all();
}

std::vector<StateChange> Gateway::changes(const std::string& instance) const {
  return impl_->instances.changes().of(instance);
}

Gateway::Outcome Gateway::wait_for(const std::string& instance, const Condition& condition, milliseconds limit,
                                   std::int64_t order_version) const {
  return impl_->instances.wait_for(instance, condition, limit, order_version);
}

}  // namespace iotcloud::gateway
