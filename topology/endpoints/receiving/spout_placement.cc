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

/// The most to which a reader raises its prefetch where bolts keep tuples: the greatest number that all brokers can
/// count.
constexpr std::uint16_t most_prefetch = 65535;

/// How often look_for_limit() runs.
constexpr std::chrono::milliseconds limit_pause{500};

/// The name of a channel's unit: for an exclusive channel that of its driver instance, for a shared one that of its
/// gateway, with the partition's number behind a mark that no id has. The unit of partition 0 has the name of the
/// whole, so that it stays when the topic is given more partitions.
std::string unit_of(const discovery::ChannelRecord& channel, int partition = 0) {
  const std::string whole = channel.shared ? "gateway-" + channel.gateway : "instance-" + channel.instance;
  return partition == 0 ? whole : whole + "#" + std::to_string(partition);
}

}  // namespace

struct SpoutPlacement::Search {
  explicit Search(StandstillFence& f) : fence(f) {}
  ~Search() { fence.ignore(listener); }
  Search(const Search&) = delete;
  Search& operator=(const Search&) = delete;

  StandstillFence& fence;
  int listener = 0;
  discovery::GuardPtr session;
  std::unique_ptr<ReadingGroup> group;
  std::unique_ptr<discovery::DriverDirectory> directory;
};

SpoutPlacement::SpoutPlacement(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint)
    : services_(std::move(services)),
      component_(std::move(component)),
      endpoint_(std::move(endpoint)),
      prefetch_report_(services_, component_, endpoint_.reading.own_prefetch) {}

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
  auto search = std::make_unique<Search>(*services_->fence);
  SplitTopics::Options topics;
  topics.component = component_;
  topics.group = group_of(endpoint_, *services_);
  topics.registry = &registry;
  topics.agreement = services_->partitions;
  topics.broker_at = [this](const brokers::BrokerAddress& address) { return broker_at(address, *services_); };
  topics.on_change = [this] {
    in_turn([&] {
      dispatcher_.assert_held();
      on_partitions();
    });
  };
  split_topics_ = std::make_unique<SplitTopics>(std::move(topics));
  split_topics_->begin();
  search->listener = services_->fence->listen([this] {
    const config::MutexLock lock(mutex_);
    if (over_ || anew_) return;
    anew_ = services_->registry->after(std::chrono::milliseconds(0), [this] {
      in_turn([&] {
        dispatcher_.assert_held();
        const auto planned = take_anew();  // destroyed here, inside its own call, so that nobody waits for that call
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
  callbacks.on_state = [this](const discovery::InstanceId& instance, std::optional<discovery::DriverState> state) {
    in_turn([&] {
      dispatcher_.assert_held();
      on_state(instance, state);
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
  discovery::GuardPtr sharing, telling, anew, looking, missing, limit;
  {
    const config::MutexLock lock(mutex_);
    if (std::exchange(over_, true)) return;
    while (in_turn_) turn_over_.wait(mutex_);
    anew.swap(anew_);
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
  telling.reset();
  looking.reset();
  missing.reset();
  limit.reset();
  for (auto& [name, unit] : units) {
    unit.readers.close();
    unit.election.reset();
  }
  if (split_topics_) split_topics_->end();
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
  if (problem.empty() && channel.shared) problem = split_topics_->difference(channel);
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
    if (before.shared && !(channel.shared && before.gateway == channel.gateway && key_of(before) == key_of(channel))) {
      follow_no_more(before);
    }
    if (unit_of(before) != unit_of(channel)) displace(before, 0, End::at_once);
  }
  warned_of_missing_ = false;
  others_.clear();
  missing_.reset();
  left_queues_.erase(channel.instance);
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

/// Removes the queue of an undeployed instance's own channel, once it has been read to its end. The queue of a stopped
/// instance stays, because that instance's next messages may come while no worker is there to declare it.
void SpoutPlacement::on_state(const discovery::InstanceId& instance, std::optional<discovery::DriverState> state) {
  const bool confirmed = unconfirmed_.erase(instance) == 0;
  if (state || !confirmed) return;
  for (auto& [name, unit] : ending_) {
    if (unit.instance == instance) unit.undeployed = true;
  }
  if (const auto left = left_queues_.extract(instance)) remove_queue(left.mapped());
}

void SpoutPlacement::remove_queue(const UnitReaders::Key& topic) {
  try {
    broker_at(topic.first, *services_)->remove_queue(topic.second, group_of(endpoint_, *services_));
  } catch (const config::Error& error) {
    endpoints_logger.warn("{}: the queue of {} stays: {}", component_, topic.second.name, error.what());
  }
}

/// Puts the channel into its units, one for each partition, unless it cannot be read.
void SpoutPlacement::place(const discovery::ChannelRecord& channel) {
  const bool usable = misfit(channel, discovery::Direction::out, endpoint_.broker).empty();
  const auto partitions =
      channel.shared && usable ? split_topics_->follow(channel, key_of(channel)) : std::optional<int>();
  if (!fits(channel)) return displace(channel, 0, usable ? End::at_once : End::when_silent);
  if (!partitions) return add_to_unit(channel, std::nullopt);
  for (int partition = 0; partition < *partitions; ++partition) add_to_unit(channel, partition);
  displace(channel, *partitions, End::at_once);
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

void SpoutPlacement::follow_no_more(const discovery::ChannelRecord& channel) {
  if (channel.shared) split_topics_->forget(channel, key_of(channel));
}

UnitReaders::Key SpoutPlacement::key_of(const discovery::ChannelRecord& channel) const {
  return {address_of(channel, *services_), topic_of(channel)};
}

/// Places channels anew whose topics are split otherwise than before, and all of them if other spouts' channels agree
/// with them no longer, or again.
void SpoutPlacement::on_partitions() {
  const auto changes = split_topics_->take_changes();
  for (const auto& [instance, channel] : channels_) {
    if (channel.shared && (changes.all || changes.instances.contains(instance))) place(channel);
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

void SpoutPlacement::look_for_limit() {
  std::size_t limited = 0, most = 0;
  const bool idle = queues_are_empty();
  for (const auto& [name, unit] : units_) {
    most = std::max(most, unit.readers.prefetch());
    if (idle) limited += unit.readers.at_limit();
  }
  prefetch_report_.look(limited, most);
  if (!units_.empty()) look_for_limit_soon();
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
    for (const auto& [instance, channel] : channels_) unconfirmed_.insert(instance);
    for (const auto& [name, unit] : ending_) unconfirmed_.insert(unit.instance);
    for (const auto& [instance, topic] : left_queues_) unconfirmed_.insert(instance);
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
  for (auto& [name, unit] : ending_) unit.readers.close();  // what they brought is void, and their drivers have stopped
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
    wanted.emplace(key_of(channel), &channel);
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
  if (const auto& [instance, channel] = *unit.channels.begin(); !channel.shared) {
    unit.instance = instance;
    unit.topic = key_of(channel);
  }
  unit.undeployed = false;
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
    if (unit.topic && unit.undeployed) {
      remove_queue(*unit.topic);
    } else if (unit.topic) {
      left_queues_.insert_or_assign(unit.instance, *unit.topic);
    }
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
