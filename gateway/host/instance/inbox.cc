#include <iotcloud/config/log.h>
#include <iotcloud/gateway/host/instance/inbox.h>

namespace iotcloud::gateway {

namespace {

constexpr config::Logger log{"gateway.host"};
constexpr std::size_t batch = 64;  ///< messages of one channel before others have their turn
constexpr std::chrono::seconds burst_pause{10};

}  // namespace

Inbox::Inbox(std::shared_ptr<EventLoop> loop, std::size_t keep_last, config::Counter& superseded, Deliver deliver)
    : loop_(std::move(loop)), keep_last_(keep_last), superseded_(superseded), deliver_(std::move(deliver)) {}

void Inbox::push(brokers::Delivery delivery) {
  std::deque<brokers::Delivery> dropped;
  {
    const std::lock_guard lock(mutex_);
    if (closed_) return;
    waiting_.push_back(std::move(delivery));
    while (keep_last_ > 0 && waiting_.size() > keep_last_) {
      dropped.push_back(std::move(waiting_.front()));
      waiting_.pop_front();
    }
    if (!scheduled_) {
      scheduled_ = true;
      loop_->post([self = shared_from_this()] { self->drain(); });
    }
  }
  superseded_.add(dropped.size());
  for (auto& old : dropped) old.settle(brokers::Settlement::accept);
}

void Inbox::drain() {
  for (std::size_t done = 0; done < batch; ++done) {
    std::unique_lock lock(mutex_);
    if (waiting_.empty()) {
      scheduled_ = false;
      return;
    }
    brokers::Delivery delivery = std::move(waiting_.front());
    waiting_.pop_front();
    lock.unlock();
    const bool handled = deliver_(std::move(delivery.message));
    delivery.settle(handled ? brokers::Settlement::accept : brokers::Settlement::reject);
  }
  loop_->post([self = shared_from_this()] { self->drain(); });
}

void Inbox::close() {
  std::deque<brokers::Delivery> unhandled;  // its destructor gives them back, outside the lock
  const std::lock_guard lock(mutex_);
  closed_ = true;
  unhandled.swap(waiting_);
}

struct SharedInboxes::Hub {
  Hub(const config::Clock& host_clock, config::Counter& unknown_counter)
      : clock(host_clock), unknown(unknown_counter), last_logged(host_clock.now() - burst_pause) {}

  void dispatch(brokers::Delivery delivery) {
    std::shared_ptr<Inbox> inbox;
    {
      const std::lock_guard lock(mutex);
      const auto found = members.find(delivery.message.driver_id);
      if (found != members.end()) inbox = found->second;
    }
    if (inbox) {
      inbox->push(std::move(delivery));
    } else {
      drop_unknown(std::move(delivery));
    }
  }

  void drop_unknown(brokers::Delivery delivery) {
    unknown.add();
    delivery.settle(brokers::Settlement::accept);
    const std::lock_guard lock(mutex);
    ++burst;
    if (clock.now() - last_logged < burst_pause) return;
    last_logged = clock.now();
    log.warn("{}: {} message(s) for driver instances that do not run here, dropped; the last for \"{}\"", topic, burst,
             delivery.message.driver_id);
    burst = 0;
  }

  const config::Clock& clock;
  config::Counter& unknown;
  std::string topic;
  std::shared_ptr<brokers::Broker> broker;
  std::mutex mutex;
  std::map<std::string, std::shared_ptr<Inbox>> members;  ///< by instance; guarded by mutex
  std::size_t burst = 0;                                  ///< guarded by mutex
  config::Clock::Instant last_logged;                     ///< guarded by mutex
  std::unique_ptr<brokers::Subscription> subscription;    ///< last: dies first, its handler uses the rest
};

void SharedInboxes::join(const std::shared_ptr<brokers::Broker>& broker, const brokers::Topic& topic,
                         const std::string& instance, std::shared_ptr<Inbox> inbox) {
  const std::lock_guard lock(mutex_);
  auto& hub = hubs_[{broker->url(), topic.name}];
  const bool first = !hub;
  if (first) {
    hub = std::make_shared<Hub>(clock_, metrics_.counter("iotcloud_host_messages_for_unknown_instance_total",
                                                         "Messages on a shared channel for an instance not in the host",
                                                         {{"topic", topic.name}}));
    hub->topic = topic.name;
    hub->broker = broker;
  }
  {
    const std::lock_guard members_lock(hub->mutex);
    hub->members[instance] = std::move(inbox);
  }
  if (!first) return;
  // No keep_last here: it would let one instance's messages supersede another's. Each inbox conflates its own.
  hub->subscription = broker->subscribe(topic, brokers::SubscriptionOptions{},
                                        [hub = hub.get()](brokers::Delivery d) { hub->dispatch(std::move(d)); });
}

void SharedInboxes::leave(const std::string& url, const brokers::Topic& topic, const std::string& instance) {
  std::shared_ptr<Hub> last;  // dies outside the lock: its subscription waits for the handler
  const std::lock_guard lock(mutex_);
  const auto found = hubs_.find({url, topic.name});
  if (found == hubs_.end()) return;
  const auto hub = found->second;
  const std::lock_guard members_lock(hub->mutex);
  found->second->members.erase(instance);
  if (!found->second->members.empty()) return;
  last = std::move(found->second);
  hubs_.erase(found);
}

}  // namespace iotcloud::gateway
