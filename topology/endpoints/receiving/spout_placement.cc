#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/yaml.h>
#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/placement/fair_shares.h>
#include <iotcloud/topology/endpoints/receiving/spout_placement.h>

namespace iotcloud::topology {

namespace {

/// After a unit comes or goes, share_out() waits this long, so that one call handles all that come or go in that time.
constexpr std::chrono::milliseconds gathering{5};

/// One line of the log names all units that are taken or given up within this time.
constexpr std::chrono::seconds gathering_for_the_log{1};

/// What a reader raises its prefetch to at most, where bolts keep tuples: what all brokers can count.
constexpr std::uint16_t most_prefetch = 65535;

/// How often the readers are looked at for one whose messages in hand have reached its prefetch, how many such looks
/// in a row mean that this is the limit, and after how many more it is said again.
constexpr std::chrono::milliseconds limit_pause{500};
constexpr int limit_looks = 3, limit_repeat = 120;

/// The name of a channel's unit: for an exclusive channel that of its driver instance, for a shared one that of its
/// gateway, with the partition's number behind a mark that no id has. The unit of partition 0 has the name of the
/// whole, so that it stays when the topic is given more partitions.
std::string unit_of(const discovery::ChannelRecord& channel, int partition = 0) {
  const std::string whole = channel.shared ? "gateway-" + channel.gateway : "instance-" + channel.instance;
  return partition == 0 ? whole : whole + "#" + std::to_string(partition);
}

}  // namespace

struct SpoutPlacement::Search {
  Search(StandstillFence& f, PartitionAgreement& p) : fence(f), partitions(p) {}
  ~Search() {
    fence.ignore(listener);
    partitions.ignore(partitions_listener);
  }
  Search(const Search&) = delete;
  Search& operator=(const Search&) = delete;

  StandstillFence& fence;
  PartitionAgreement& partitions;
  int listener = 0, partitions_listener = 0;
  discovery::GuardPtr session;
  std::unique_ptr<ReadingGroup> group;
  std::unique_ptr<discovery::DriverDirectory> directory;
};

SpoutPlacement::SpoutPlacement(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint)
    : services_(std::move(services)), component_(std::move(component)), endpoint_(std::move(endpoint)) {}

SpoutPlacement::~SpoutPlacement() = default;

void SpoutPlacement::join(int task_index, int task_count, std::shared_ptr<SpoutQueue> queue) {
  {
    const config::MutexLock lock(mutex_);
    queues_[task_index] = std::move(queue);
    if (queues_.size() < static_cast<std::size_t>(task_count)) return;
  }
  dispatcher_.assert_held();  // no callback comes before the search
  loads_ = TaskLoads(static_cast<std::size_t>(task_count));
  path_ = readers_path(endpoint_, *services_);
  // Callbacks on the dispatcher take mutex_. So it is not held here, nor in leave() while the watches are destroyed,
  // which waits for callbacks that run.
  auto& registry = *services_->registry;
  auto search = std::make_unique<Search>(*services_->fence, *services_->partitions);
  search->partitions_listener = services_->partitions->listen([this] {
    const config::MutexLock lock(mutex_);
    agreement_changed_ = true;
    partitions_changed_soon();
  });
  search->listener = services_->fence->listen([this] {
    const config::MutexLock lock(mutex_);
    if (over_ || anew_) return;
    anew_ = services_->registry->after(std::chrono::milliseconds(0), [this] {
      in_turn([&] {
        dispatcher_.assert_held();
        const auto planned = take_anew();  // dies here, where nobody waits for it
        subscribe_anew();
      });
    });
  });
  search->session = registry.on_session([this](discovery::SessionState state) {
    in_turn([&] {
      dispatcher_.assert_held();
      on_session(state);
    });
  });
  ReadingGroup::Member self;
  self.sharer = {services_->worker, task_count};
  self.topology = services_->topology;
  self.shares = !endpoint_.group.empty();
  self.broker = endpoint_.broker;
  self.where = endpoint_.where.everything() ? "" : endpoint_.where.text();
  self.since_ms = services_->clock->wall_ms();
  search->group = std::make_unique<ReadingGroup>(registry, path_, std::move(self),
                                                 [this](const auto& sharers, const std::string& problem) {
                                                   in_turn([&] {
                                                     dispatcher_.assert_held();
                                                     on_sharers(sharers, problem);
                                                   });
                                                 });
  discovery::DriverDirectory::Callbacks callbacks;
  callbacks.on_channel = [this](const discovery::ChannelRecord& channel) {
    in_turn([&] {
      dispatcher_.assert_held();
      on_channel(channel);
    });
  };
  callbacks.on_channel_gone = [this](const discovery::ChannelRecord& channel) {
    in_turn([&] {
      dispatcher_.assert_held();
      on_channel_gone(channel);
    });
  };
  callbacks.on_missing = [this](const discovery::InstanceId&, const std::vector<discovery::ChannelRecord>& channels) {
    in_turn([&] {
      dispatcher_.assert_held();
      on_missing(channels);
    });
  };
  if (!endpoint_.where.everything()) {
    callbacks.on_verdict = [this](const discovery::InstanceId& instance, std::optional<bool> chosen) {
      verdicts_->told(instance, chosen);
    };
  }
  search->directory = std::make_unique<discovery::DriverDirectory>(
      registry, services_->paths, endpoint_.driver, endpoint_.channel, std::move(callbacks), endpoint_.where);
  search_ = std::move(search);
}

void SpoutPlacement::leave() {
  std::map<std::string, Unit> units;
  discovery::GuardPtr sharing, telling, anew, looking, missing, partitions, limit;
  {
    const config::MutexLock lock(mutex_);
    if (std::exchange(over_, true)) return;
    while (in_turn_) turn_over_.wait(mutex_);
    anew.swap(anew_);
    partitions.swap(partitions_soon_);
    queues_.clear();
  }
  dispatcher_.assert_held();  // no callback begins any more
  units.swap(units_);
  units.merge(ending_);  // no name is in both
  sharing.swap(sharing_);
  telling.swap(telling_);
  looking.swap(looking_);
  missing.swap(missing_);
  limit.swap(limit_);
  search_.reset();
  sharing.reset();
  anew.reset();
  partitions.reset();
  telling.reset();
  looking.reset();
  missing.reset();
  limit.reset();
  for (auto& [name, unit] : units) {
    unit.readers.close();
    unit.election.reset();
  }
  for (const auto& [instance, channel] : channels_) services_->partitions->set(source_of(channel), channel.name, 0);
  topics_.clear();
}

bool SpoutPlacement::begin_turn() {
  const config::MutexLock lock(mutex_);
  while (in_turn_) turn_over_.wait(mutex_);
  if (over_) return false;
  in_turn_ = true;
  return true;
}

void SpoutPlacement::end_turn() {
  const config::MutexLock lock(mutex_);
  in_turn_ = false;
  turn_over_.notify_all();
}

std::shared_ptr<SpoutQueue> SpoutPlacement::queue_of(int task) {
  const config::MutexLock lock(mutex_);
  return queues_.at(task);
}

discovery::GuardPtr SpoutPlacement::take_anew() {
  const config::MutexLock lock(mutex_);
  return std::move(anew_);
}

bool SpoutPlacement::fits(const discovery::ChannelRecord& channel) {
  std::string problem = misfit(channel, discovery::Direction::out, endpoint_.broker);
  if (problem.empty() && channel.shared) problem = services_->partitions->difference(source_of(channel));
  if (problem.empty()) return true;
  if (complained_.insert(channel.gateway + problem).second) {
    endpoints_logger.warn("{}: channel {} of driver {} on gateway {} is not read: {}", component_, channel.name,
                          channel.driver, channel.gateway, problem);
  }
  return false;
}

void SpoutPlacement::on_channel(const discovery::ChannelRecord& channel) {
  const auto known = channels_.find(channel.instance);
  if (known != channels_.end()) {
    const discovery::ChannelRecord before = known->second;
    if (before.shared &&
        !(channel.shared && before.gateway == channel.gateway &&
          address_of(before, *services_) == address_of(channel, *services_) && topic_of(before) == topic_of(channel))) {
      follow_no_more(before);
    }
    if (unit_of(before) != unit_of(channel)) displace(before, 0, End::at_once);
  }
  warned_of_missing_ = false;
  others_.clear();
  channels_.insert_or_assign(channel.instance, channel);
  place(channel);
  look_for_limit_soon();
  report();
}

void SpoutPlacement::on_channel_gone(const discovery::ChannelRecord& channel) {
  channels_.erase(channel.instance);
  displace(channel, 0, End::when_silent);
  follow_no_more(channel);
  report();
}

/// Puts the channel into its units, one for each partition, unless it cannot be read.
void SpoutPlacement::place(const discovery::ChannelRecord& channel) {
  const bool usable = misfit(channel, discovery::Direction::out, endpoint_.broker).empty();
  const SplitTopic* const topic = channel.shared && usable ? &follow(channel) : nullptr;
  if (!fits(channel)) return displace(channel, 0, usable ? End::at_once : End::when_silent);
  if (topic == nullptr || !topic->watch) return add_to_unit(channel, std::nullopt);
  for (int partition = 0; partition < topic->count; ++partition) add_to_unit(channel, partition);
  displace(channel, topic->count, End::at_once);
}

void SpoutPlacement::add_to_unit(const discovery::ChannelRecord& channel, std::optional<std::int32_t> partition) {
  const std::string name = unit_of(channel, partition.value_or(0));
  begin_again(name);
  const auto [place, fresh] = units_.try_emplace(name, reader_count_);
  Unit& unit = place->second;
  unit.kind = channel.shared ? UnitKind::gateway : UnitKind::instance;
  unit.partition = partition;
  unit.channels[channel.instance] = channel;
  if (fresh && alone()) stand(name, unit);
  if (fresh && !alone()) share_out_soon();
  if (unit.task >= 0) read(unit);
}

/// Takes the channel out of the units of its partitions from the given one on.
void SpoutPlacement::displace(const discovery::ChannelRecord& channel, int first_partition, End end) {
  for (int partition = first_partition;; ++partition) {
    const std::string name = unit_of(channel, partition);
    if (!units_.contains(name)) return;
    remove_from_unit(channel, name, end);
  }
}

PartitionAgreement::Source SpoutPlacement::source_of(const discovery::ChannelRecord& channel) const {
  return {group_of(endpoint_, *services_), channel.driver, channel.gateway};
}

/// Begins to follow how often the channel's topic is split, unless that is done already.
SpoutPlacement::SplitTopic& SpoutPlacement::follow(const discovery::ChannelRecord& channel) {
  const UnitReaders::Key key(address_of(channel, *services_), topic_of(channel));
  const auto [place, fresh] = topics_.try_emplace(key);
  SplitTopic& topic = place->second;
  topic.instances.insert(channel.instance);
  if (!fresh) return topic;
  try {
    topic.broker = broker_at(key.first, *services_);
    topic.watch = topic.broker->watch_partitions(key.second, [this, key](int count) { on_partitions(key, count); });
  } catch (const config::Error& error) {  // open_reader() complains of it
    endpoints_logger.debug("{}: {}", component_, error.what());
  }
  return topic;
}

void SpoutPlacement::follow_no_more(const discovery::ChannelRecord& channel) {
  if (!channel.shared) return;
  const auto found = topics_.find({address_of(channel, *services_), topic_of(channel)});
  if (found == topics_.end()) return;
  found->second.instances.erase(channel.instance);
  if (!found->second.instances.empty()) return;
  topics_.erase(found);
  const bool still_read = std::any_of(channels_.begin(), channels_.end(), [&](const auto& entry) {
    return entry.first != channel.instance && entry.second.shared && entry.second.gateway == channel.gateway;
  });
  if (!still_read) services_->partitions->set(source_of(channel), channel.name, 0);
}

/// The broker calls it on its own thread.
void SpoutPlacement::on_partitions(const UnitReaders::Key& topic, int count) {
  const config::MutexLock lock(mutex_);
  told_partitions_[topic] = count;
  partitions_changed_soon();
}

void SpoutPlacement::partitions_changed_soon() {
  if (over_ || partitions_soon_) return;
  partitions_soon_ = services_->registry->after(std::chrono::milliseconds(0), [this] {
    in_turn([&] {
      dispatcher_.assert_held();
      take_partitions();
    });
  });
}

/// Places channels anew whose topics are split otherwise than before, and all of them if other spouts' channels agree
/// with them no longer, or again.
void SpoutPlacement::take_partitions() {
  std::map<UnitReaders::Key, int> told;
  discovery::GuardPtr planned;  // dies here, where nobody waits for it
  bool all = false;
  {
    const config::MutexLock lock(mutex_);
    told.swap(told_partitions_);
    planned.swap(partitions_soon_);
    all = std::exchange(agreement_changed_, false);
  }
  std::set<discovery::InstanceId> changed;
  for (const auto& [key, count] : told) {
    const auto found = topics_.find(key);
    if (found == topics_.end()) continue;
    SplitTopic& topic = found->second;
    if (std::exchange(topic.count, count) != count) changed.insert(topic.instances.begin(), topic.instances.end());
    endpoints_logger.debug("{}: topic {} has {} partitions", component_, key.second.name, count);
    const auto channel = channels_.find(*topic.instances.begin());
    if (channel != channels_.end()) services_->partitions->set(source_of(channel->second), channel->second.name, count);
  }
  for (const auto& [instance, channel] : channels_) {
    if (channel.shared && (all || changed.contains(instance))) place(channel);
  }
  report();
}

void SpoutPlacement::remove_from_unit(const discovery::ChannelRecord& channel, const std::string& name, End end) {
  const auto found = units_.find(name);
  if (found == units_.end() || !found->second.channels.contains(channel.instance)) return;
  Unit& unit = found->second;
  if (unit.channels.size() > 1) {
    unit.channels.erase(channel.instance);
    if (unit.task >= 0) read(unit);
    return;
  }
  // Messages of an instance that `where` chooses no longer stay at the broker.
  if (end == End::when_silent && unit.task >= 0 && verdicts_->of(channel.instance.str()).value_or(true)) {
    read_to_the_end(found->first);
  } else {
    release(found->first, unit);
    units_.erase(found);
  }
  share_out_soon();
}

void SpoutPlacement::on_missing(const std::vector<discovery::ChannelRecord>& channels) {
  if (!channels_.empty()) return;
  for (const auto& channel : channels) {
    if (channel.direction == discovery::Direction::out) others_.insert(channel.name);
  }
  if (std::exchange(warned_of_missing_, true)) return;
  // Not at once: another instance, whose record was not read yet, may have the channel.
  missing_ = services_->registry->after(gathering_for_the_log, [this] {
    in_turn([&] {
      dispatcher_.assert_held();
      warn_of_missing();
    });
  });
}

void SpoutPlacement::warn_of_missing() {
  if (!channels_.empty()) {
    warned_of_missing_ = false;
    return;
  }
  const std::vector<std::string> names(others_.begin(), others_.end());
  std::string list;
  for (const auto& name : names) list += (list.empty() ? "\"" : ", \"") + name + "\"";
  const std::string guess = config::nearest(endpoint_.channel, names);
  endpoints_logger.warn("{}: waits for the channel \"{}\", which no active instance of the driver {} has; {}{}",
                        component_, endpoint_.channel, endpoint_.driver,
                        names.empty() ? "they have no outgoing channel" : "their outgoing channels are " + list,
                        guess.empty() ? "" : fmt::format("; did you mean \"{}\"?", guess));
}

void SpoutPlacement::look_for_limit_soon() {
  if (endpoint_.reading.automatic_ack || std::exchange(limit_soon_, true)) return;
  limit_ = services_->registry->after(limit_pause, [this] {
    in_turn([&] {
      dispatcher_.assert_held();
      limit_soon_ = false;
      look_for_limit();
    });
  });
}

bool SpoutPlacement::queues_are_empty() {
  const config::MutexLock lock(mutex_);
  return std::all_of(queues_.begin(), queues_.end(), [](const auto& entry) { return entry.second->size() == 0; });
}

/// Says when messages wait at the broker although the spout has nothing to emit, because as many as the broker hands
/// out are in the topology, unsettled: a window, or a bolt that acks late, gets only so many at a time.
void SpoutPlacement::look_for_limit() {
  std::size_t limited = 0, most = 0;
  const bool idle = queues_are_empty();
  for (const auto& [name, unit] : units_) {
    most = std::max(most, unit.readers.prefetch());
    if (idle) limited += unit.readers.at_limit();
  }
  limited_looks_ = limited > 0 ? limited_looks_ + 1 : 0;
  const config::Labels labels{{"topology", services_->topology.str()}, {"component", component_}};
  auto& metrics = *services_->metrics;
  metrics.gauge("iotcloud_spout_prefetch", "The most unsettled messages that a channel may have now", labels)
      .set(static_cast<std::int64_t>(most));
  metrics
      .gauge("iotcloud_spout_prefetch_limited",
             "Channels of which as many messages as the broker hands out are unsettled, so that the others wait",
             labels)
      .set(limited_looks_ >= limit_looks ? static_cast<std::int64_t>(limited) : 0);
  const std::string text = limited_looks_ >= limit_looks ? limit_text(limited, most) : "";
  services_->held->set_limit(component_, text);
  if (!text.empty() && (limited_looks_ - limit_looks) % limit_repeat == 0)
    endpoints_logger.warn("{}: {}", component_, text);
  if (!units_.empty()) look_for_limit_soon();
}

std::string SpoutPlacement::limit_text(std::size_t limited, std::size_t most) const {
  const auto keepers = services_->keepers.find(component_);
  const bool kept = keepers != services_->keepers.end();
  const std::string mend =
      kept && !endpoint_.reading.own_prefetch
          ? fmt::format(
                "it was not raised further, because of the memory for such messages ({} MiB) or of the broker; "
                "keep less, or set prefetchCount",
                HeldMessages::usual_limit >> 20U)
          : "set prefetchCount above the number of messages that come in that time";
  return fmt::format(
      "prefetchCount ({}) is the limit: of {} channel(s) so many messages are in the topology, unsettled, and the "
      "others wait at the broker; {}; {}",
      most, limited, kept ? "bolts keep tuples: " + keepers->second : "a bolt acks late", mend);
}

void SpoutPlacement::on_sharers(const std::vector<Sharer>& sharers, const std::string& problem) {
  if (problem != problem_ && !problem.empty()) {
    endpoints_logger.error("{}: channel {} of driver {} is not read here: {}", component_, endpoint_.channel,
                           endpoint_.driver, problem);
  }
  problem_ = problem;
  sharers_ = sharers;
  share_out();
  balance();
  report();
}

void SpoutPlacement::on_elected(const std::string& name) {
  const auto found = units_.find(name);
  if (found == units_.end()) return;
  Unit& unit = found->second;
  unit.leads = true;
  unit.frozen = false;
  if (unit.task < 0) {
    const std::size_t task = loads_.idlest(unit.kind);
    loads_.add(task, unit.kind);
    unit.task = static_cast<int>(task);
    ++taken_;
    tell_soon();
    endpoints_logger.debug("{}: {} is read here, by task {}", component_, name, task);
  }
  read(unit);
  report();
}

void SpoutPlacement::on_lost(const std::string& name) {
  if (const auto ending = ending_.find(name); ending != ending_.end()) ending->second.leads = false;
  const auto found = units_.find(name);
  if (found == units_.end()) return;
  Unit& unit = found->second;
  unit.leads = false;
  if (services_->registry->session() != discovery::SessionState::connected) {
    unit.frozen = true;
    return;
  }
  stop_reading(name, unit);
  balance();
  report();
}

/// When the registry is back, gives up the units that were kept without it, unless this worker was elected for them
/// again. When the session has expired, other workers are elected for the units. If the broker cannot be reached
/// either, it delivers this worker's unsettled messages to those workers, so the fence is raised.
void SpoutPlacement::on_session(discovery::SessionState state) {
  if (state == discovery::SessionState::expired) {
    const auto is_cut_off = [](const auto& entry) { return entry.second.readers.cut_off(); };
    if (std::any_of(units_.begin(), units_.end(), is_cut_off) ||
        std::any_of(ending_.begin(), ending_.end(), is_cut_off)) {
      services_->fence->raise();
    }
  }
  if (state != discovery::SessionState::connected) return;
  for (auto& [name, unit] : units_) {
    if (std::exchange(unit.frozen, false) && !unit.leads) stop_reading(name, unit);
  }
  share_out();
  balance();
  report();
}

/// Closes and opens all readers after the fence was raised: the broker then delivers only to the reader that it accepts
/// now.
void SpoutPlacement::subscribe_anew() {
  for (auto& [name, unit] : units_) {
    if (unit.task < 0) continue;
    unit.readers.close();
    read(unit);
  }
  for (auto& [name, unit] : ending_) unit.readers.close();  // they are void, and nobody needs them for long
}

void SpoutPlacement::stop_reading(const std::string& name, Unit& unit) {
  unit.readers.close();
  unit.move = Move::none;
  if (unit.task < 0) return;
  loads_.remove(static_cast<std::size_t>(unit.task), unit.kind);
  unit.task = -1;
  ++given_up_;
  tell_soon();
  endpoints_logger.debug("{}: {} is read here no longer", component_, name);
}

/// Closes the unit's readers that no channel needs any more, and opens those that are missing.
void SpoutPlacement::read(Unit& unit) {
  UnitReaders::Wanted wanted;
  for (const auto& [instance, channel] : unit.channels) {
    wanted.emplace(UnitReaders::Key(address_of(channel, *services_), topic_of(channel)), &channel);
  }
  unit.readers.keep_only(wanted);
  if (unit.move != Move::none) return;  // look_at_moves() opens them when the move is over
  unit.readers.open_missing(wanted, [&](const discovery::ChannelRecord& channel, const UnitReaders::Key& key) {
    dispatcher_.assert_held();
    return open_reader(channel, key, unit);
  });
}

std::shared_ptr<TopicReader> SpoutPlacement::open_reader(const discovery::ChannelRecord& channel,
                                                         const UnitReaders::Key& key, const Unit& unit) {
  brokers::SubscriptionOptions options;
  options.group = group_of(endpoint_, *services_);
  options.automatic_ack = endpoint_.reading.automatic_ack;
  options.prefetch = static_cast<std::uint16_t>(endpoint_.reading.prefetch);
  if (services_->keepers.contains(component_) && !endpoint_.reading.own_prefetch)
    options.prefetch_limit = most_prefetch;
  options.keep_last = static_cast<std::size_t>(endpoint_.reading.keep_last);
  options.priority = priority_of(channel);
  options.partition = unit.partition;
  try {
    return TopicReader::open(broker_at(key.first, *services_), key.first, key.second, options,
                             {channel.gateway, channel.shared ? discovery::InstanceId() : channel.instance},
                             queue_of(unit.task), services_->fence, services_->held);
  } catch (const config::Error& error) {
    if (complained_.insert(key.first.urls.front()).second) {
      endpoints_logger.error("{}: {} cannot be read: {}", component_, key.second.name, error.what());
    }
    return nullptr;
  }
}

// Decides who reads which unit: fair shares among the workers, and even loads of this worker's tasks.

void SpoutPlacement::share_out_soon() {
  if (std::exchange(sharing_soon_, true)) return;
  sharing_ = services_->registry->after(gathering, [this] {
    in_turn([&] {
      dispatcher_.assert_held();
      sharing_soon_ = false;
      share_out();
      balance();
      report();
    });
  });
}

void SpoutPlacement::share_out() {
  if (sharers_.empty()) return;
  if (alone()) {
    for (auto& [name, unit] : units_) stand(name, unit);
    return;
  }
  std::vector<std::vector<std::string>> names(unit_kinds);
  for (const auto& [name, unit] : units_) names[static_cast<std::size_t>(unit.kind)].push_back(name);
  const auto shares = fair_shares(names, sharers_);
  for (std::size_t kind = 0; kind < unit_kinds; ++kind) {
    for (std::size_t i = 0; i < names[kind].size(); ++i) {
      const std::string& name = names[kind][i];
      Unit& unit = units_.at(name);
      if (sharers_[shares[kind][i]].worker == services_->worker) {
        stand(name, unit);
      } else if (unit.election && unit.task < 0) {
        release(name, unit);  // no message of it is in hand
      } else if (unit.election && !unit.frozen) {
        move(name, unit, Move::to_worker);
      }
    }
  }
}

void SpoutPlacement::stand(const std::string& name, Unit& unit) {
  // it stays in this worker after all, and is read again when it is drained
  if (unit.move == Move::to_worker) unit.move = Move::to_task;
  if (unit.election) return;
  discovery::Election::Callbacks callbacks;
  callbacks.on_elected = [this, name](std::int64_t) {
    in_turn([&] {
      dispatcher_.assert_held();
      on_elected(name);
    });
  };
  callbacks.on_lost = [this, name] {
    in_turn([&] {
      dispatcher_.assert_held();
      on_lost(name);
    });
  };
  unit.election = std::make_unique<discovery::Election>(*services_->registry, ReadingGroup::election(path_, name),
                                                        services_->worker, std::move(callbacks),
                                                        discovery::Succession::whoever_is_first);
}

/// Begins to move a unit: drains its readers. look_at_moves() ends the move.
void SpoutPlacement::move(const std::string& name, Unit& unit, Move where) {
  if (unit.move == Move::none) {
    unit.looks_left = static_cast<int>(drain_limit / look_period);
    unit.readers.drain();
    moving_.insert(name);
    look_soon();
  }
  unit.move = where;
}

void SpoutPlacement::look_soon() {
  if (std::exchange(looking_soon_, true)) return;
  looking_ = services_->registry->after(look_period, [this] {
    in_turn([&] {
      dispatcher_.assert_held();
      looking_soon_ = false;
      look_at_moves();
      look_at_ends();
      balance();
      report();
    });
  });
}

/// Ends the moves of units that are drained, or that were not drained within drain_limit: the broker delivers the
/// unsettled messages of the latter again to the next reader.
void SpoutPlacement::look_at_moves() {
  for (auto name = moving_.begin(); name != moving_.end();) {
    const auto found = units_.find(*name);
    const bool moves = found != units_.end() && found->second.move != Move::none;
    if (moves && found->second.looks_left-- > 0 && found->second.readers.have_in_hand()) {
      ++name;
      continue;
    }
    if (moves && found->second.move == Move::to_worker && !found->second.frozen) {
      release(*name, found->second);
    } else if (moves) {
      found->second.move = Move::none;
      found->second.readers.close();
      read(found->second);
    }
    name = moving_.erase(name);
  }
  if (!moving_.empty()) look_soon();
}

/// The last channel of a unit that is read here is gone: the unit leaves the placement, and is read to its end.
void SpoutPlacement::read_to_the_end(const std::string& name) {
  Unit& unit = units_.at(name);
  if (std::exchange(unit.move, Move::none) != Move::none) {  // its readers take nothing any more
    unit.readers.close();
    read(unit);
  }
  unit.channels.clear();
  loads_.remove(static_cast<std::size_t>(unit.task), unit.kind);
  unit.last_task = std::exchange(unit.task, -1);
  unit.looks_left = static_cast<int>(end_limit / look_period);
  unit.silent_looks = 0;
  unit.taken = unit.readers.taken();
  ++given_up_;
  tell_soon();
  ending_.insert(units_.extract(name));
  look_soon();
}

void SpoutPlacement::look_at_ends() {
  for (auto place = ending_.begin(); place != ending_.end();) {
    auto& [name, unit] = *place;
    const std::size_t taken = unit.readers.taken();
    const bool silent =
        std::exchange(unit.taken, taken) == taken && !unit.readers.have_in_hand() && !unit.readers.cut_off();
    unit.silent_looks = silent ? unit.silent_looks + 1 : 0;
    const bool over = unit.silent_looks * look_period >= end_silence;
    if (!over && unit.looks_left-- > 0) {
      ++place;
      continue;
    }
    if (!over) {
      endpoints_logger.warn("{}: {} has stopped and was not read to its end within {} s; the broker keeps the rest",
                            component_, name, std::chrono::duration_cast<std::chrono::seconds>(end_limit).count());
    }
    release(name, unit);
    place = ending_.erase(place);
  }
  if (!ending_.empty()) look_soon();
}

/// A channel of a unit that is being read to its end is back: the unit is read as before, without an interruption.
void SpoutPlacement::begin_again(const std::string& name) {
  const auto ending = ending_.find(name);
  if (ending == ending_.end()) return;
  Unit& unit = ending->second;
  if (!unit.leads || unit.frozen) {
    release(name, unit);
    ending_.erase(ending);
    return;
  }
  unit.task = unit.last_task;
  loads_.add(static_cast<std::size_t>(unit.task), unit.kind);
  ++taken_;
  tell_soon();
  units_.insert(ending_.extract(ending));
  share_out_soon();
}

/// Gives a unit up. Closes the readers before it resigns as leader, so that the next leader finds the topic free.
void SpoutPlacement::release(const std::string& name, Unit& unit) {
  stop_reading(name, unit);
  if (unit.election) resigned_.push_back(std::move(unit.election));
  unit.leads = false;
  unit.frozen = false;
}

/// Moves units between this worker's tasks while they are uneven.
void SpoutPlacement::balance() {
  while (const auto next = loads_.next_move()) {
    const auto moved = std::find_if(units_.begin(), units_.end(), [&](const auto& entry) {
      return entry.second.kind == next->kind && entry.second.task == static_cast<int>(next->from);
    });
    Unit& unit = moved->second;
    loads_.remove(next->from, unit.kind);
    loads_.add(next->to, unit.kind);
    unit.task = static_cast<int>(next->to);
    endpoints_logger.debug("{}: {} moves from task {} to {}", component_, moved->first, next->from, next->to);
    move(moved->first, unit, unit.move == Move::none ? Move::to_task : unit.move);
  }
}

void SpoutPlacement::report() {
  services_->metrics
      ->gauge("iotcloud_spout_channels", "Channels that this worker reads; of split topics, partitions",
              {{"topology", services_->topology}, {"component", component_}})
      .set(static_cast<std::int64_t>(reader_count_));
}

/// Plans a line of the log about the units taken and given up; one line for all, because units come by the thousand.
void SpoutPlacement::tell_soon() {
  if (std::exchange(telling_soon_, true)) return;
  telling_ = services_->registry->after(gathering_for_the_log, [this] {
    in_turn([&] {
      dispatcher_.assert_held();
      telling_soon_ = false;
      const auto read =
          std::count_if(units_.begin(), units_.end(), [](const auto& unit) { return unit.second.task >= 0; });
      endpoints_logger.info("{}: units taken {}, given up {}; {} of {} are read here", component_,
                            std::exchange(taken_, 0), std::exchange(given_up_, 0), read, units_.size());
    });
  });
}

}  // namespace iotcloud::topology
