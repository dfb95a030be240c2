#include <algorithm>
#include <array>

#include <fmt/format.h>

#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/sending/route_table.h>

namespace iotcloud::topology {

namespace {

/// Time between two lines in the log about drivers that are not there.
constexpr std::chrono::seconds quiet_time{10};
/// How many ids of instances that are gone are kept.
constexpr std::size_t most_departed = 10'000;

/// The worker stops: the next one gets the message of a tuple that would wait.
void leave_to_the_next(SenderMeters& meters, const Tuple& tuple, OutputCollector& collector) {
  meters.lost("closed");
  collector.retry(tuple);
}

}  // namespace

RouteTable::RouteTable(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint)
    : services_(std::move(services)), component_(std::move(component)), endpoint_(std::move(endpoint)) {}

RouteTable::~RouteTable() = default;

void RouteTable::join() {
  const config::MutexLock joining(joining_);
  if (tasks_++ > 0) return;
  {
    const config::MutexLock lock(mutex_);
    const config::Labels labels{{"topology", services_->topology}, {"component", component_}};
    meters_ = std::make_shared<SenderMeters>(*services_->metrics, labels);
    unknown_ = &services_->metrics->counter("iotcloud_bolt_unknown_driver_total",
                                            "Tuples for a driver that is not there", labels);
  }
  discovery::DriverDirectory::Callbacks callbacks;
  callbacks.on_channel = [this](const discovery::ChannelRecord& channel) { on_channel(channel); };
  callbacks.on_channel_gone = [this](const discovery::ChannelRecord& channel) { on_channel_gone(channel); };
  callbacks.on_record = [this](const discovery::InstanceId& instance, const discovery::DriverRecord* record, bool) {
    on_record(instance, record);
  };
  if (!endpoint_.where.everything()) {
    callbacks.on_choice = [this](const discovery::InstanceId& instance, std::optional<bool> chosen) {
      on_choice(instance, chosen);
    };
  }
  directory_ = std::make_unique<discovery::DriverDirectory>(*services_->registry, services_->paths, endpoint_.driver,
                                                            endpoint_.channel, std::move(callbacks), endpoint_.where);
}

void RouteTable::leave(const OutputCollector& collector) {
  std::deque<Waiting> forgotten;
  const config::MutexLock joining(joining_);
  {
    const config::MutexLock lock(mutex_);
    sent_.wait(mutex_, [&]() IOTCLOUD_REQUIRES(mutex_) { return sending_ != &collector; });
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
    const config::MutexLock lock(mutex_);
    routes_.clear();
    known_.clear();
    senders_.clear();
    uses_.clear();
  }
  for (const auto& sender : last) sender->close();
}

std::vector<std::shared_ptr<ChannelSender>> RouteTable::senders() const {
  std::vector<std::shared_ptr<ChannelSender>> all;
  const config::MutexLock lock(mutex_);
  for (const auto& [sender, count] : uses_) all.push_back(sender);
  return all;
}

/// Ends one route's use of the sender. \return the sender when no other route uses it.
std::shared_ptr<ChannelSender> RouteTable::drop(std::shared_ptr<ChannelSender> sender) {
  const auto use = uses_.find(sender);
  if (use == uses_.end() || --use->second > 0) return nullptr;
  uses_.erase(use);
  return sender;
}

void RouteTable::send(brokers::Message message, const Tuple& tuple, OutputCollector& collector) {
  config::UniqueLock lock(mutex_);
  const auto line = waiting_.find(message.driver_id);
  const auto route = routes_.find(message.driver_id);
  if (route != routes_.end() && line == waiting_.end()) {
    const auto sender = route->second.sender;
    message.gateway_id = route->second.gateway;
    lock.unlock();
    sender->send(std::move(message), tuple, collector);
    return;
  }
  const auto now = services_->clock->now();
  note_tuple(message.driver_id, now);
  const bool waits = line != waiting_.end() || (!no_grace_ && end_of_wait(message.driver_id, now) > now);
  if (waits && (waiting_count_ < most_waiting || comes(message.driver_id))) {
    ++waiting_count_;
    auto& queue = waiting_[discovery::InstanceId(message.driver_id)];
    queue.push_back({std::move(message), tuple, &collector, now});
    return;
  }
  if (no_grace_ && comes(message.driver_id)) {
    const auto meters = meters_;
    lock.unlock();
    leave_to_the_next(*meters, tuple, collector);
    return;
  }
  const Reason reason = waits ? Reason::too_many_wait : why_nobody(message.driver_id);
  lock.unlock();
  drop(reason, message.driver_id, tuple, collector);
}

/// Notes that a tuple has come for an instance that has no route.
void RouteTable::note_tuple(std::string_view instance, Instant now) {
  Known* const known = inactive(instance);
  if (!known) return;
  if (!known->last_tuple || now - *known->last_tuple >= grace) known->first_tuple = now;
  known->last_tuple = now;
}

/// What is known of the instance if it is inactive; otherwise null.
RouteTable::Known* RouteTable::inactive(std::string_view instance) {
  const auto known = known_.find(instance);
  return known != known_.end() && known->second.state == discovery::DriverState::inactive ? &known->second : nullptr;
}

/// Whether the instance has a record that says that it is about to be active. A restart goes through `stopping` too,
/// and one after a failure of the driver through `failed`.
bool RouteTable::comes(std::string_view instance) const {
  using discovery::DriverState;
  const auto known = known_.find(instance);
  if (known == known_.end() || unchosen_.contains(instance)) return false;
  const DriverState state = known->second.state;
  return state == DriverState::deployed || state == DriverState::starting || state == DriverState::stopping ||
         (state == DriverState::failed && known->second.starts_again);
}

/// Until when a tuple that came at `since` waits for an instance that has no route.
RouteTable::Instant RouteTable::end_of_wait(std::string_view instance, Instant since) const {
  using discovery::DriverState;
  if (unchosen_.contains(instance)) return Instant::min();
  if (const auto departed = departed_.find(instance); departed != departed_.end()) return departed->second + grace;
  const auto deadline = endpoint_.sending.deadline;
  if (comes(instance)) return since + (deadline.count() > 0 ? deadline : std::chrono::milliseconds(return_limit));
  const auto known = known_.find(instance);
  if (known == known_.end()) return since + grace;
  // The instance is active, but the registry has not told its channel yet. Tuples that came while it was about to be
  // active have waited, so their grace counts from when it became active.
  if (known->second.state == DriverState::active) return std::max(since, known->second.since) + grace;
  return std::max(known->second.since, known->second.first_tuple) + grace;
}

/// Sends the tuples that waited for a driver whose channel is there now, in order and before new ones. Runs on the
/// registry's dispatcher.
void RouteTable::send_waiting(const discovery::InstanceId& instance) {
  config::UniqueLock lock(mutex_);
  while (true) {
    const auto line = waiting_.find(instance);
    if (line == waiting_.end()) return;
    const auto route = routes_.find(instance);
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
    const auto waited = std::chrono::duration_cast<std::chrono::milliseconds>(services_->clock->now() - next.since);
    sender->send(std::move(next.message), next.tuple, *next.collector, waited);
    next.tuple = {};
    lock.lock();
    sending_ = nullptr;
    sent_.notify_all();
  }
}

void RouteTable::on_tick() {
  std::deque<Dropped> late;
  const auto now = services_->clock->now();
  {
    const config::MutexLock lock(mutex_);
    for (auto line = waiting_.begin(); line != waiting_.end();) {
      auto& tuples = line->second;
      const bool being_sent = routes_.contains(line->first);  // by send_waiting(), which also erases the line
      while (!being_sent && !tuples.empty() && end_of_wait(line->first.str(), tuples.front().since) <= now) {
        const Reason reason = why_late(tuples.front(), now);
        late.push_back({std::move(tuples.front()), reason});
        tuples.pop_front();
        --waiting_count_;
        // Those that follow could not come before, if their spout may have no more under way.
        if (Known* const known = inactive(line->first.str())) known->last_tuple = now;
      }
      for (const auto& waiting : tuples) waiting.collector->reset_timeout(waiting.tuple);
      line = tuples.empty() && !being_sent ? waiting_.erase(line) : std::next(line);
    }
  }
  for (const auto& [waiting, reason] : late) drop(reason, waiting.message.driver_id, waiting.tuple, *waiting.collector);
  for (const auto& sender : senders()) sender->reset_timeouts();
}

void RouteTable::end_grace() {
  std::deque<Dropped> late;
  std::deque<Waiting> for_the_next;
  std::shared_ptr<SenderMeters> meters;
  const auto now = services_->clock->now();
  {
    const config::MutexLock lock(mutex_);
    no_grace_ = true;
    meters = meters_;
    for (auto line = waiting_.begin(); line != waiting_.end();) {
      if (routes_.contains(line->first)) {  // send_waiting() is sending them
        ++line;
        continue;
      }
      for (auto& waiting : line->second) {
        if (comes(line->first.str())) {
          for_the_next.push_back(std::move(waiting));
        } else {
          const Reason reason = why_late(waiting, now);
          late.push_back({std::move(waiting), reason});
        }
      }
      waiting_count_ -= line->second.size();
      line = waiting_.erase(line);
    }
  }
  for (const auto& [waiting, reason] : late) drop(reason, waiting.message.driver_id, waiting.tuple, *waiting.collector);
  for (const auto& waiting : for_the_next) leave_to_the_next(*meters, waiting.tuple, *waiting.collector);
}

/// Why a tuple for an instance without a route does not wait, or not any longer.
RouteTable::Reason RouteTable::why_nobody(std::string_view instance) const {
  const auto known = known_.find(instance);
  if (known == known_.end() || unchosen_.contains(instance)) return Reason::unknown;
  if (comes(instance)) return Reason::not_started;
  return known->second.state == discovery::DriverState::active ? Reason::no_channel : Reason::inactive;
}

RouteTable::Reason RouteTable::why_late(const Waiting& waiting, Instant now) const {
  const auto deadline = endpoint_.sending.deadline;
  if (deadline.count() > 0 && now - waiting.since >= deadline) return Reason::deadline;
  return why_nobody(waiting.message.driver_id);
}

void RouteTable::drop(Reason reason, const std::string& instance, const Tuple& tuple, OutputCollector& collector) {
  static constexpr std::array names{"unknown", "inactive", "not_started", "no_channel", "too_many_wait", "deadline"};
  bool say_it = false;
  std::size_t untold = 0;
  {
    const config::MutexLock lock(mutex_);
    if (reason == Reason::unknown) {
      unknown_->add();
    } else {
      meters_->lost(names[static_cast<std::size_t>(reason)]);
    }
    const auto now = services_->clock->now();
    say_it = reason != Reason::deadline && (!last_told_ || now - *last_told_ >= quiet_time);
    if (say_it) {
      last_told_ = now;
      untold = std::exchange(untold_, 0);
    } else if (reason != Reason::deadline) {
      ++untold_;
    }
  }
  if (say_it) {
    endpoints_logger.warn("{}: {}{}", component_, line_about(reason, instance),
                          untold == 0 ? "" : fmt::format("; {} more such tuples since the last such line", untold));
  }
  if (reason != Reason::deadline && endpoint_.sending.unknown_driver == UnknownDriver::fail) {
    collector.fail(tuple);
  } else {
    collector.ack(tuple);
  }
}

std::string RouteTable::line_about(Reason reason, const std::string& instance) const {
  const auto about = [&](std::string_view what) {
    return fmt::format("a tuple for the driver {} with the id \"{}\" is not sent: {}", endpoint_.driver, instance,
                       what);
  };
  switch (reason) {
    case Reason::inactive:
      return about("it is stopped, or has failed");
    case Reason::not_started:
      return about("it was about to be active for too long");
    case Reason::no_channel:
      return about(fmt::format("it has no channel \"{}\" that can be used", endpoint_.channel));
    case Reason::too_many_wait:
      return about(fmt::format("{} tuples wait already", most_waiting));
    case Reason::unknown:
    case Reason::deadline:
      break;
  }
  return fmt::format("there is no driver {} with the id \"{}\" and a channel \"{}\"{}", endpoint_.driver, instance,
                     endpoint_.channel, endpoint_.where.everything() ? "" : " that \"where\" chooses");
}

bool RouteTable::fits(const discovery::ChannelRecord& channel) {
  const std::string problem = misfit(channel, discovery::Direction::in, endpoint_.broker);
  if (problem.empty()) return true;
  const config::MutexLock lock(mutex_);
  if (complained_.insert(channel.gateway + problem).second) {
    endpoints_logger.warn("{}: nothing is sent to channel {} of driver {} on gateway {}: {}", component_, channel.name,
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
    const config::MutexLock lock(mutex_);
    Route& route = routes_[channel.instance];
    if (route.sender != sender) {
      ++uses_[sender];
      replaced = drop(std::exchange(route.sender, sender));
    }
    route.gateway = channel.gateway;
  }
  if (replaced) replaced->close();
  send_waiting(channel.instance);
}

void RouteTable::on_channel_gone(const discovery::ChannelRecord& channel) {
  std::shared_ptr<ChannelSender> unused;
  {
    const config::MutexLock lock(mutex_);
    const auto found = routes_.find(channel.instance);
    if (found == routes_.end()) return;
    unused = drop(std::move(found->second.sender));
    routes_.erase(found);
  }
  if (unused) unused->close();
}

/// Notes what the instance's record says, which decides how long tuples wait for it.
void RouteTable::on_record(const discovery::InstanceId& instance, const discovery::DriverRecord* record) {
  const config::MutexLock lock(mutex_);
  if (!record) {
    known_.erase(instance);
    if (departed_.size() >= most_departed) departed_.erase(departed_.begin());
    departed_.insert_or_assign(instance, services_->clock->now());
    return;
  }
  departed_.erase(instance);
  const Known said{record->state, record->starts_again, services_->clock->now()};
  const auto [known, fresh] = known_.try_emplace(instance, said);
  const bool the_same = known->second.state == said.state && known->second.starts_again == said.starts_again;
  if (!fresh && !the_same) known->second = said;
}

/// Notes whether `where` chooses the instance: tuples for an instance that is there but not chosen do not wait for it.
void RouteTable::on_choice(const discovery::InstanceId& instance, std::optional<bool> chosen) {
  const config::MutexLock lock(mutex_);
  if (chosen.value_or(true)) {
    unchosen_.erase(instance);
  } else {
    unchosen_.insert(instance);
  }
}

/// The sender of the channel's topic, made if there is none yet. \return null when its broker cannot be used, which is
/// logged once.
std::shared_ptr<ChannelSender> RouteTable::sender_for(const discovery::ChannelRecord& channel) {
  const SenderKey key(address_of(channel, *services_), topic_of(channel));
  std::shared_ptr<SenderMeters> meters;
  {
    const config::MutexLock lock(mutex_);
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
                                      meters, services_->fence);
    const config::MutexLock lock(mutex_);
    senders_[key] = sender;
    return sender;
  } catch (const config::Error& error) {
    const config::MutexLock lock(mutex_);
    if (complained_.insert(key.first.urls.front()).second) {
      endpoints_logger.error("{}: nothing can be sent to {}: {}", component_, key.second.name, error.what());
    }
    return nullptr;
  }
}

}  // namespace iotcloud::topology
