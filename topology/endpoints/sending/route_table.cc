#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/sending/route_table.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};
/// Between two lines in the log about drivers that are not there.
constexpr std::chrono::seconds quiet_time{10};
/// So many ids of instances that went are remembered.
constexpr std::size_t most_departed = 10'000;

}  // namespace

RouteTable::RouteTable(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint)
    : services_(std::move(services)), component_(std::move(component)), endpoint_(std::move(endpoint)) {}

RouteTable::~RouteTable() = default;

void RouteTable::join() {
  const std::lock_guard joining(joining_);
  if (tasks_++ > 0) return;
  {
    const std::lock_guard lock(mutex_);
    const config::Labels labels{{"topology", services_->topology}, {"component", component_}};
    meters_ = std::make_shared<SenderMeters>(*services_->metrics, labels);
    unknown_ = &services_->metrics->counter("iotcloud_bolt_unknown_driver_total",
                                            "Tuples for a driver that is not there", labels);
  }
  discovery::DriverDirectory::Callbacks callbacks;
  callbacks.on_channel = [this](const discovery::ChannelRecord& channel) { on_channel(channel); };
  callbacks.on_channel_gone = [this](const discovery::ChannelRecord& channel) { on_channel_gone(channel); };
  if (!endpoint_.where.everything()) {
    callbacks.on_verdict = [this](const std::string& instance, std::optional<bool> chosen) {
      on_verdict(instance, chosen);
    };
  }
  directory_ = std::make_unique<discovery::DriverDirectory>(*services_->registry, services_->paths, endpoint_.driver,
                                                            endpoint_.channel, std::move(callbacks), endpoint_.where);
}

void RouteTable::leave(const OutputCollector& collector) {
  std::deque<Waiting> forgotten;
  const std::lock_guard joining(joining_);
  {
    std::unique_lock lock(mutex_);
    sent_.wait(lock, [&] { return sending_ != &collector; });
    for (auto& [id, line] : waiting_) {
      for (auto& waiting : line) {
        if (waiting.collector == &collector) forgotten.push_back(std::move(waiting));
      }
      waiting_count_ -= std::erase_if(line, [](const Waiting& waiting) { return !waiting.tuple; });
    }
  }
  for (const auto& sender : senders()) sender->forget(collector);
  if (--tasks_ > 0) return;
  directory_.reset();  // no callback runs any more
  const auto last = senders();
  {
    const std::lock_guard lock(mutex_);
    routes_.clear();
    senders_.clear();
    uses_.clear();
  }
  for (const auto& sender : last) sender->close();
}

std::vector<std::shared_ptr<ChannelSender>> RouteTable::senders() const {
  std::vector<std::shared_ptr<ChannelSender>> all;
  const std::lock_guard lock(mutex_);
  for (const auto& [sender, count] : uses_) all.push_back(sender);
  return all;
}

/// A route uses it no longer. \return it, when no other route does. With mutex_ held.
std::shared_ptr<ChannelSender> RouteTable::drop(std::shared_ptr<ChannelSender> sender) {
  const auto use = uses_.find(sender);
  if (use == uses_.end() || --use->second > 0) return nullptr;
  uses_.erase(use);
  return sender;
}

void RouteTable::send(brokers::Message message, const Tuple& tuple, OutputCollector& collector) {
  std::unique_lock lock(mutex_);
  const auto line = waiting_.find(message.driver_id);
  const auto route = routes_.find(message.driver_id);
  if (route != routes_.end() && line == waiting_.end()) {
    const auto sender = route->second.sender;
    message.gateway_id = route->second.gateway;
    lock.unlock();
    sender->send(std::move(message), tuple, collector);
    return;
  }
  const bool away = departed_.contains(message.driver_id) || unchosen_.contains(message.driver_id);
  const bool waits = line != waiting_.end() || (!no_grace_ && !away);
  if (waits && waiting_count_ < most_waiting) {
    ++waiting_count_;
    std::string id = message.driver_id;
    waiting_[id].push_back({std::move(message), tuple, &collector, services_->clock->now()});
    return;
  }
  lock.unlock();
  unknown(message.driver_id, tuple, collector);
}

/// The driver's channel is there: what waited for it goes first, in order. On the dispatcher.
void RouteTable::send_waiting(const std::string& driver_id) {
  std::unique_lock lock(mutex_);
  while (true) {
    const auto line = waiting_.find(driver_id);
    if (line == waiting_.end()) return;
    const auto route = routes_.find(driver_id);
    if (line->second.empty() || route == routes_.end()) {
      if (line->second.empty()) waiting_.erase(line);
      return;
    }
    Waiting next = std::move(line->second.front());
    line->second.pop_front();
    --waiting_count_;
    const auto sender = route->second.sender;
    next.message.gateway_id = route->second.gateway;
    sending_ = next.collector;
    lock.unlock();
    sender->send(std::move(next.message), next.tuple, *next.collector);
    next.tuple = {};
    lock.lock();
    sending_ = nullptr;
    sent_.notify_all();
  }
}

void RouteTable::on_tick() {
  std::deque<Waiting> late;
  {
    const std::lock_guard lock(mutex_);
    const auto now = services_->clock->now();
    for (auto line = waiting_.begin(); line != waiting_.end();) {
      auto& tuples = line->second;
      while (!tuples.empty() && now - tuples.front().since >= grace) {
        late.push_back(std::move(tuples.front()));
        tuples.pop_front();
        --waiting_count_;
      }
      line = tuples.empty() && !routes_.contains(line->first) ? waiting_.erase(line) : std::next(line);
    }
  }
  give_up(late);
  for (const auto& sender : senders()) sender->reset_timeouts();
}

void RouteTable::end_grace() {
  std::deque<Waiting> late;
  {
    const std::lock_guard lock(mutex_);
    no_grace_ = true;
    for (auto line = waiting_.begin(); line != waiting_.end();) {
      if (routes_.contains(line->first)) {  // they are being sent
        ++line;
        continue;
      }
      std::move(line->second.begin(), line->second.end(), std::back_inserter(late));
      waiting_count_ -= line->second.size();
      line = waiting_.erase(line);
    }
  }
  give_up(late);
}

void RouteTable::give_up(const std::deque<Waiting>& late) {
  for (const auto& [message, tuple, collector, since] : late) unknown(message.driver_id, tuple, *collector);
}

void RouteTable::unknown(const std::string& driver_id, const Tuple& tuple, OutputCollector& collector) {
  bool say_it = false;
  std::size_t untold = 0;
  {
    const std::lock_guard lock(mutex_);
    unknown_->add();
    const auto now = services_->clock->now();
    say_it = !last_unknown_ || now - *last_unknown_ >= quiet_time;
    if (say_it) {
      last_unknown_ = now;
      untold = std::exchange(untold_unknown_, 0);
    } else {
      ++untold_unknown_;
    }
  }
  if (say_it) {
    logger.warn("{}: there is no driver {} with the id \"{}\" and a channel \"{}\"{}{}", component_, endpoint_.driver,
                driver_id, endpoint_.channel, endpoint_.where.everything() ? "" : " that \"where\" chooses",
                untold == 0 ? "" : fmt::format("; {} more such tuples since the last such line", untold));
  }
  if (endpoint_.sending.unknown_driver == UnknownDriver::fail) {
    collector.fail(tuple);
  } else {
    collector.ack(tuple);
  }
}

bool RouteTable::fits(const discovery::ChannelRecord& channel) {
  std::string problem;
  if (channel.direction != discovery::Direction::in) {
    problem = "it brings messages from the driver";
  } else if (channel.transport != endpoint_.broker) {
    problem =
        "it goes over the broker \"" + channel.transport + "\", and the topology says \"" + endpoint_.broker + "\"";
  } else if (topic_of(channel).name.empty()) {
    problem = "its record names no topic";
  }
  if (problem.empty()) return true;
  const std::lock_guard lock(mutex_);
  if (complained_.insert(channel.gateway + problem).second) {
    logger.warn("{}: nothing is sent to channel {} of driver {} on gateway {}: {}", component_, channel.name,
                channel.driver, channel.gateway, problem);
  }
  return false;
}

void RouteTable::on_channel(const discovery::ChannelRecord& channel) {
  auto sender = fits(channel) ? sender_for(channel) : nullptr;
  if (!sender) {
    on_channel_gone(channel);
    return;
  }
  std::shared_ptr<ChannelSender> replaced;
  {
    const std::lock_guard lock(mutex_);
    Route& route = routes_[channel.instance];
    if (route.sender != sender) {
      ++uses_[sender];
      replaced = drop(std::exchange(route.sender, sender));
    }
    route.gateway = channel.gateway;
    departed_.erase(channel.instance);
  }
  if (replaced) replaced->close();
  send_waiting(channel.instance);
}

void RouteTable::on_channel_gone(const discovery::ChannelRecord& channel) {
  std::shared_ptr<ChannelSender> unused;
  {
    const std::lock_guard lock(mutex_);
    const auto found = routes_.find(channel.instance);
    if (found == routes_.end()) return;
    unused = drop(std::move(found->second.sender));
    routes_.erase(found);
    if (departed_.size() >= most_departed) departed_.erase(departed_.begin());
    departed_.insert(channel.instance);
  }
  if (unused) unused->close();
}

/// What is for an instance that is there and not chosen does not wait for it.
void RouteTable::on_verdict(const std::string& instance, std::optional<bool> chosen) {
  const std::lock_guard lock(mutex_);
  if (chosen.value_or(true)) {
    unchosen_.erase(instance);
  } else {
    unchosen_.insert(instance);
  }
}

/// The topic's sender; a new one when there is none yet. Null, which is said once, when its broker cannot be used.
std::shared_ptr<ChannelSender> RouteTable::sender_for(const discovery::ChannelRecord& channel) {
  const SenderKey key(address_of(channel, *services_), topic_of(channel));
  std::shared_ptr<SenderMeters> meters;
  {
    const std::lock_guard lock(mutex_);
    if (senders_.size() > most_senders_) {
      std::erase_if(senders_, [](const auto& entry) { return entry.second.expired(); });
      most_senders_ = std::max<std::size_t>(64, 2 * senders_.size());
    }
    const auto found = senders_.find(key);
    if (found != senders_.end()) {
      if (auto sender = found->second.lock()) return sender;
    }
    meters = meters_;
  }
  brokers::PublisherOptions options;
  options.when_full = endpoint_.sending.keep_newest ? brokers::WhenFull::keep_newest : brokers::WhenFull::block;
  options.capacity = static_cast<std::size_t>(endpoint_.sending.capacity);
  options.deadline = endpoint_.sending.deadline;
  options.priority = priority_of(channel);
  try {
    auto sender = ChannelSender::open(broker_at(key.first, *services_), key.second, options, endpoint_.sending.ack_when,
                                      std::move(meters), services_->fence);
    const std::lock_guard lock(mutex_);
    senders_[key] = sender;
    return sender;
  } catch (const config::Error& error) {
    const std::lock_guard lock(mutex_);
    if (complained_.insert(key.first.urls.front()).second) {
      logger.error("{}: nothing can be sent to {}: {}", component_, key.second.name, error.what());
    }
    return nullptr;
  }
}

}  // namespace iotcloud::topology
