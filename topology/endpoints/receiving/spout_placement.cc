#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/yaml.h>
#include <iotcloud/topology/endpoints/logger.h>
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

/// How often look_at_arrivals() runs, and how many readers' brokers it asks each time: of ten thousand channels each is
/// asked once in 50 s.
constexpr std::chrono::seconds arrivals_pause{1};
constexpr std::size_t most_questions = 200;

/// After the fence was raised: how often it is looked whether the registry has answered, and after what time without an
/// answer reading goes on.
constexpr std::chrono::milliseconds answer_pause{10}, answer_limit{2000};

/// How often it is tried to open topics that could not be opened.
constexpr std::chrono::seconds opening_pause{2};

/// The part of a component's troubles that tells of them.
const std::string topics_part = "topics";

/// The name of a channel's unit: for an exclusive channel that of its driver instance, for a shared one that of its
/// gateway, with the partition's number behind a mark that no id has. The unit of partition 0 has the name of the
/// whole, so that it stays when the topic is given more partitions.
std::string unit_of(const discovery::ChannelRecord& channel, int partition = 0) {
  const std::string whole = channel.shared ? "gateway-" + channel.gateway : "instance-" + channel.instance;
  return partition == 0 ? whole : whole + "#" + std::to_string(partition);
}

/// Runs for leader of a unit until it is destroyed.
class Candidacy final : public discovery::Guard {
 public:
  Candidacy(discovery::Registry& registry, std::string path, std::string worker,
            discovery::Election::Callbacks callbacks)
      : election_(registry, std::move(path), std::move(worker), std::move(callbacks),
                  discovery::Succession::whoever_is_first) {}

 private:
  const discovery::Election election_;
};

}  // namespace

struct SpoutPlacement::Search {
  Search(StandstillFence& f, DriverUnits& of_all, DriverUnits::Source of, const std::string& spout)
      : fence(f), units(of_all), source(std::move(of)), component(spout) {}
  ~Search() {
    fence.ignore(listener);
    units.ignore(source, component);
  }
  Search(const Search&) = delete;
  Search& operator=(const Search&) = delete;

  StandstillFence& fence;
  DriverUnits& units;
  const DriverUnits::Source source;
  const std::string& component;
  int listener = 0;
  config::Metrics::SourceRegistration metrics;
  discovery::GuardPtr session;
  std::unique_ptr<ReadingGroup> group;
  std::unique_ptr<discovery::DriverDirectory> directory;
};

SpoutPlacement::SpoutPlacement(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint)
    : services_(std::move(services)),
      component_(std::move(component)),
      endpoint_(std::move(endpoint)),
      units_({.component = component_,
              .worker = services_->worker,
              .run_for_leader = [this](const std::string& unit) { return run_for_leader(unit); },
              .open_reader =
                  [this](const auto& channel, const auto& topic, auto partition, int task) {
                    dispatcher_.assert_held();
                    return open_reader(channel, topic, partition, task);
                  },
              .shared_together =
                  [this](const UnitNames& own) {
                    dispatcher_.assert_held();
                    const auto source = source_of(endpoint_, *services_);
                    services_->units->set(source, component_, own);
                    return alike_ ? services_->units->of(source) : own;
                  },
              .longest_drain = services_->longest_drain.value_or(SpoutUnits::drain_limit)}),
      prefetch_report_(services_, component_, endpoint_.reading.own_prefetch) {}

SpoutPlacement::~SpoutPlacement() = default;

void SpoutPlacement::join(int task_index, int task_count, std::shared_ptr<SpoutQueue> queue) {
  {
    const config::MutexLock lock(mutex_);
    queues_[task_index] = std::move(queue);
    if (queues_.size() < static_cast<std::size_t>(task_count)) return;
  }
  dispatcher_.assert_held();  // no callback comes before the search
  units_.begin(static_cast<std::size_t>(task_count));
  path_ = readers_path(endpoint_, *services_);
  // Callbacks on the dispatcher take mutex_. So it is not held here, nor in leave() while the watches are destroyed,
  // which waits for callbacks that run.
  auto& registry = *services_->registry;
  const auto source = source_of(endpoint_, *services_);
  auto search = std::make_unique<Search>(*services_->fence, *services_->units, source, component_);
  SplitTopics::Options topics;
  topics.component = component_;
  topics.group = group_of(endpoint_, *services_);
  topics.registry = &registry;
  topics.agreement = agreement_of(component_, *services_);
  topics.broker_at = [this](const brokers::BrokerAddress& address) { return broker_at(address, *services_); };
  topics.on_change = [this] {
    in_turn([&] {
      dispatcher_.assert_held();
      on_partitions();
    });
  };
  split_topics_ = std::make_unique<SplitTopics>(std::move(topics));
  split_topics_->begin();
  search->metrics = services_->metrics->add_source([arrivals = arrivals_, labels = labels()](auto& samples) {
    const Arrivals::Facts facts = arrivals->facts();
    const auto add = [&](const char* name, const char* help, double value) {
      samples.push_back({name, help, labels, config::Sample::Kind::gauge, value, {}});
    };
    if (facts.age_ms) {
      add("iotcloud_spout_arrival_age_seconds",
          "How old the oldest message was that came in the last second in which any came, by its own time",
          static_cast<double>(*facts.age_ms) / 1000);
    }
    if (facts.backlog.known > 0) {
      add("iotcloud_spout_backlog", "Messages that wait at brokers for the channels that this worker reads",
          static_cast<double>(facts.backlog.messages));
    }
  });
  search->listener =
      services_->fence->listen([this] { plan_soon(&SpoutPlacement::after_fence_, &SpoutPlacement::hold_back); });
  services_->units->listen(source, component_,
                           [this] { plan_soon(&SpoutPlacement::after_others_, &SpoutPlacement::share_out); });
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
  self.spouts = services_->units->description(source);
  self.engine = services_->engine;
  search->group = std::make_unique<ReadingGroup>(registry, path_, std::move(self), [this](const auto& shares) {
    in_turn([&] {
      dispatcher_.assert_held();
      on_shares(shares);
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
  callbacks.on_record = [this](const discovery::InstanceId& instance, const discovery::DriverRecord* record,
                               bool chosen) {
    if (record != nullptr) {
      known_instances_->told(instance, record->gateway, chosen);
    } else {
      known_instances_->gone(instance);
    }
    in_turn([&] {
      dispatcher_.assert_held();
      on_state(instance, record ? std::optional(record->state) : std::nullopt);
    });
  };
  search->directory = std::make_unique<discovery::DriverDirectory>(
      registry, services_->paths, endpoint_.driver, endpoint_.channel, std::move(callbacks), endpoint_.where);
  search_ = std::move(search);
}

void SpoutPlacement::leave() {
  discovery::GuardPtr after_fence, after_others;
  {
    const config::MutexLock lock(mutex_);
    if (std::exchange(over_, true)) return;
    while (in_turn_) turn_over_.wait(mutex_);
    after_fence.swap(after_fence_);
    after_others.swap(after_others_);
    queues_.clear();
  }
  dispatcher_.assert_held();  // no callback begins any more
  search_.reset();
  after_fence.reset();
  after_others.reset();
  plans_ = {};
  question_.reset();
  differences_.clear();
  while (!differing_.empty()) {
    const auto shown = differing_.begin();
    shown->second.clear();
    show_difference(Difference(shown->first));
  }
  units_.close();
  show_missing();
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

void SpoutPlacement::plan(PlannedCall& plan, std::chrono::milliseconds pause, void (SpoutPlacement::*call)()) {
  if (std::exchange(plan.made, true)) return;
  plan.timer = services_->registry->after(pause, [this, &plan, call] {
    in_turn([&] {
      dispatcher_.assert_held();
      plan.made = false;
      (this->*call)();
    });
  });
}

void SpoutPlacement::plan_what_follows() {
  if (units_.needs_sharing()) plan(plans_.sharing, gathering, &SpoutPlacement::share_out);
  if (units_.needs_look()) plan(plans_.looking, SpoutUnits::look_period, &SpoutPlacement::look);
  if (units_.has_changes()) plan(plans_.telling, gathering_for_the_log, &SpoutPlacement::tell);
  if (units_.size() > 0 && !endpoint_.reading.automatic_ack) {
    plan(plans_.limit, limit_pause, &SpoutPlacement::look_for_limit);
  }
  if (units_.held_back()) plan(plans_.reading, answer_pause, &SpoutPlacement::read_anew);
  if (units_.missing() > 0) plan(plans_.opening, opening_pause, &SpoutPlacement::open_missing);
  if (units_.readers() > 0) plan(plans_.arrivals, arrivals_pause, &SpoutPlacement::look_at_arrivals);
}

void SpoutPlacement::plan_soon(discovery::GuardPtr SpoutPlacement::*timer, void (SpoutPlacement::*call)()) {
  const config::MutexLock lock(mutex_);
  if (over_ || this->*timer) return;
  this->*timer = services_->registry->after(std::chrono::milliseconds(0), [this, timer, call] {
    in_turn([&] {
      dispatcher_.assert_held();
      const auto planned = take(timer);  // destroyed here, inside its own call, so that nobody waits for that call
      (this->*call)();
    });
  });
}

discovery::GuardPtr SpoutPlacement::take(discovery::GuardPtr SpoutPlacement::*timer) {
  const config::MutexLock lock(mutex_);
  return std::move(this->*timer);
}

bool SpoutPlacement::fits(const discovery::ChannelRecord& channel, const std::string& unfit) {
  const std::string difference = unfit.empty() ? split_topics_->difference(channel) : std::string();
  set_difference(channel, difference);
  const std::string& problem = unfit.empty() ? difference : unfit;
  if (problem.empty()) return true;
  // One warning for all instances of a gateway with the same problem: there may be thousands.
  if (complained_.insert(channel.gateway + problem).second) {
    endpoints_logger.warn("{}: channel {} of driver {} on gateway {} is not read: instance {}: {}", component_,
                          channel.name, channel.driver, channel.gateway, channel.instance, problem);
  }
  return false;
}

/// Shows why this instance's channel is not read, until a later call has another text. \param text empty: the
/// channel is read, or gone, or not read for a reason that is shown elsewhere
void SpoutPlacement::set_difference(const discovery::ChannelRecord& channel, const std::string& text) {
  const Difference now(channel.gateway, text);
  const auto known = differences_.find(channel.instance);
  if (known == differences_.end() ? text.empty() : known->second == now) return;
  if (known != differences_.end()) {
    const Difference before = known->second;
    differences_.erase(known);
    differing_[before].erase(channel.instance);
    show_difference(before);
  }
  if (text.empty()) return;
  differences_.emplace(channel.instance, now);
  differing_[now].insert(channel.instance);
  show_difference(now);
}

/// Shows how many instances have the difference.
void SpoutPlacement::show_difference(const Difference& difference) {
  const auto found = differing_.find(difference);
  const auto& [gateway, why] = difference;
  std::string text;
  if (found->second.empty()) {
    differing_.erase(found);
  } else {
    const auto others = found->second.size() - 1;
    text = fmt::format("channel {} of driver {} on gateway {} is not read: instance {}{}: {}", endpoint_.channel,
                       endpoint_.driver, gateway, *found->second.begin(),
                       others == 0 ? "" : fmt::format(" and {} other{}", others, others == 1 ? "" : "s"), why);
  }
  services_->troubles->set(component_, "partitions of " + gateway + ": " + why, text);
}

void SpoutPlacement::on_channel(const discovery::ChannelRecord& channel) {
  const auto known = channels_.find(channel.instance);
  if (known != channels_.end()) {
    const discovery::ChannelRecord before = known->second;
    const bool readable = misfit(channel, discovery::Direction::out, endpoint_.broker).empty();
    const bool same_topic = before.gateway == channel.gateway && key_of(before) == key_of(channel);
    if (!(before.shared == channel.shared && readable && same_topic)) follow_no_more(before);
    if (unit_of(before) != unit_of(channel)) displace(before, 0, SpoutUnits::End::at_once);
  }
  warned_of_missing_ = false;
  others_.clear();
  plans_.missing = {};
  left_queues_.erase(channel.instance);
  channels_.insert_or_assign(channel.instance, channel);
  place(channel);
}

void SpoutPlacement::on_channel_gone(const discovery::ChannelRecord& channel) {
  channels_.erase(channel.instance);
  displace(channel, 0, SpoutUnits::End::when_silent);
  follow_no_more(channel);
  set_difference(channel, {});
}

/// Removes the queue of an undeployed instance's own channel, once it has been read to its end. The queue of a stopped
/// instance stays, because that instance's next messages may come while no worker is there to declare it.
void SpoutPlacement::on_state(const discovery::InstanceId& instance, std::optional<discovery::DriverState> state) {
  const bool confirmed = unconfirmed_.erase(instance) == 0;
  if (state || !confirmed) return;
  units_.undeployed(instance);
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
  const std::string unfit = misfit(channel, discovery::Direction::out, endpoint_.broker);
  std::optional<int> partitions;
  if (unfit.empty()) partitions = split_topics_->follow(channel, key_of(channel));
  if (!fits(channel, unfit)) {
    return displace(channel, 0, unfit.empty() ? SpoutUnits::End::at_once : SpoutUnits::End::when_silent);
  }
  if (!partitions) return add_to_unit(channel, std::nullopt);
  const int count = partitions.value();
  for (int partition = 0; partition < count; ++partition) add_to_unit(channel, partition);
  displace(channel, count, SpoutUnits::End::at_once);
}

void SpoutPlacement::add_to_unit(const discovery::ChannelRecord& channel, std::optional<std::int32_t> partition) {
  units_.add(unit_of(channel, partition.value_or(0)), channel, key_of(channel), partition);
}

/// Takes the channel out of the units of its partitions from the given one on.
void SpoutPlacement::displace(const discovery::ChannelRecord& channel, int first_partition, SpoutUnits::End end) {
  // Messages of an instance that `where` chooses no longer stay at the broker.
  if (!known_instances_->may_be_chosen(channel.instance)) end = SpoutUnits::End::at_once;
  for (int partition = first_partition;; ++partition) {
    const std::string name = unit_of(channel, partition);
    if (!units_.contains(name)) return;
    units_.remove(name, channel.instance, end);
  }
}

void SpoutPlacement::follow_no_more(const discovery::ChannelRecord& channel) {
  split_topics_->forget(channel, key_of(channel));
}

UnitReaders::Key SpoutPlacement::key_of(const discovery::ChannelRecord& channel) const {
  return {address_of(channel, *services_), topic_of(channel)};
}

/// Places channels anew whose topics are split otherwise than before, and all of them if other spouts' channels agree
/// with them no longer, or again.
void SpoutPlacement::on_partitions() {
  const auto changes = split_topics_->take_changes();
  for (const auto& [instance, channel] : channels_) {
    if (changes.all || changes.instances.contains(instance)) place(channel);
  }
}

void SpoutPlacement::on_missing(const std::vector<discovery::ChannelRecord>& channels) {
  if (!channels_.empty()) return;
  for (const auto& channel : channels) {
    if (channel.direction == discovery::Direction::out) others_.insert(channel.name);
  }
  if (std::exchange(warned_of_missing_, true)) return;
  // Not at once: another instance, whose record was not read yet, may have the channel.
  plan(plans_.missing, gathering_for_the_log, &SpoutPlacement::warn_of_missing);
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

bool SpoutPlacement::queues_are_empty() {
  const config::MutexLock lock(mutex_);
  return std::all_of(queues_.begin(), queues_.end(), [](const auto& entry) { return entry.second->size() == 0; });
}

void SpoutPlacement::on_shares(const ReadingGroup::Shares& shares) {
  if (shares.problem != problem_ && !shares.problem.empty()) {
    endpoints_logger.error("{}: channel {} of driver {} is not read here: {}", component_, endpoint_.channel,
                           endpoint_.driver, shares.problem);
  }
  problem_ = shares.problem;
  alike_ = shares.alike;
  units_.set_sharers(shares.sharers);
  units_.share_out();
}

void SpoutPlacement::on_lost(const std::string& unit) {
  units_.on_lost(unit, services_->registry->session() != discovery::SessionState::connected);
}

/// When the registry is back, gives up the units that were kept without it, unless this worker was elected for them
/// again. When the session has expired, other workers are elected for the units. If the broker cannot be reached
/// either, it delivers this worker's unsettled messages to those workers, so the fence is raised.
void SpoutPlacement::on_session(discovery::SessionState state) {
  if (state == discovery::SessionState::expired) {
    if (units_.cut_off()) services_->fence->raise();
    for (const auto& [instance, channel] : channels_) unconfirmed_.insert(instance);
    unconfirmed_.merge(units_.ending_instances());
    for (const auto& [instance, topic] : left_queues_) unconfirmed_.insert(instance);
  }
  if (state != discovery::SessionState::connected) return;
  question_.reset();  // an answer that comes now may be earlier than what there is to say of elections
  units_.registry_back();
}

discovery::GuardPtr SpoutPlacement::run_for_leader(const std::string& unit) {
  discovery::Election::Callbacks callbacks;
  callbacks.on_elected = [this, unit](std::int64_t) {
    in_turn([&] {
      dispatcher_.assert_held();
      units_.on_elected(unit);
    });
  };
  callbacks.on_lost = [this, unit] {
    in_turn([&] {
      dispatcher_.assert_held();
      on_lost(unit);
    });
  };
  return std::make_unique<Candidacy>(*services_->registry, ReadingGroup::election(path_, unit), services_->worker,
                                     std::move(callbacks));
}

std::shared_ptr<TopicReader> SpoutPlacement::open_reader(const discovery::ChannelRecord& channel,
                                                         const UnitReaders::Key& key,
                                                         std::optional<std::int32_t> partition, int task) {
  brokers::SubscriptionOptions options;
  options.group = group_of(endpoint_, *services_);
  options.automatic_ack = endpoint_.reading.automatic_ack;
  options.prefetch = static_cast<std::uint16_t>(endpoint_.reading.prefetch);
  if (services_->keepers.contains(component_) && !endpoint_.reading.own_prefetch)
    options.prefetch_limit = most_prefetch;
  options.keep_last = static_cast<std::size_t>(endpoint_.reading.keep_last);
  options.priority = priority_of(channel);
  options.partition = partition;
  try {
    return TopicReader::open(broker_at(key.first, *services_), key.first, key.second, options,
                             {channel.gateway, channel.shared ? discovery::InstanceId() : channel.instance},
                             queue_of(task), services_->fence, services_->held);
  } catch (const config::Error& error) {
    unreadable_ = fmt::format("{}: {}", key.second.name, error.what());
    if (complained_.insert(key.first.urls.front()).second) {
      endpoints_logger.error("{}: {} cannot be read, which is tried again: {}", component_, key.second.name,
                             error.what());
    }
    return nullptr;
  }
}

// What plan_what_follows() plans.

void SpoutPlacement::hold_back() {
  units_.hold_back();
  question_.reset();
  registry_answered_ = false;
  looks_left_ = static_cast<int>(answer_limit / answer_pause);
}

/// Reads anew when the registry has answered, and what it had to say of elections before has been heard. The question
/// is a watch, because a call would keep this turn, and the registry's other callbacks, waiting for a silent registry.
void SpoutPlacement::read_anew() {
  if (registry_answered_ || looks_left_-- <= 0) {
    question_.reset();
    return units_.read_anew();
  }
  if (question_ || services_->registry->session() != discovery::SessionState::connected) return;
  question_ = services_->registry->watch_node(path_ + "/members/" + services_->worker, [this](const auto&) {
    in_turn([&] {
      dispatcher_.assert_held();
      on_answer();
    });
  });
}

void SpoutPlacement::on_answer() {
  registry_answered_ = true;
  question_.reset();
  plans_.reading = {};  // the next look is a whole pause away, so that what was said of elections is heard first
}

void SpoutPlacement::open_missing() {
  units_.open_missing();
}

void SpoutPlacement::share_out() {
  units_.share_out();
}

void SpoutPlacement::look() {
  for (const auto& [instance, topic, undeployed] : units_.look()) {
    if (undeployed) {
      remove_queue(topic);
    } else {
      left_queues_.insert_or_assign(instance, topic);
    }
  }
}

void SpoutPlacement::look_for_limit() {
  prefetch_report_.look(queues_are_empty() ? units_.at_limit() : 0, units_.prefetch());
}

void SpoutPlacement::look_at_arrivals() {
  units_.ask_backlog(most_questions);
  arrivals_->look(units_.backlog());
  if (units_.list_read_here(read_units_)) arrivals_->set_units(read_units_);
}

/// Writes one line in the log about all units taken and given up, because units come by the thousand.
void SpoutPlacement::tell() {
  const auto [taken, given_up] = units_.take_changes();
  endpoints_logger.info("{}: units taken {}, given up {}; {} of {} are read here", component_, taken, given_up,
                        units_.read_here(), units_.size());
}

/// Shows how many topics cannot be opened.
void SpoutPlacement::show_missing() {
  if (unreadable_.empty()) return;
  std::string text;
  if (units_.missing() == 0) {
    unreadable_.clear();
  } else {
    text = fmt::format("channel {} of driver {}: {} topic(s) cannot be read; every {} s it is tried again; {}",
                       endpoint_.channel, endpoint_.driver, units_.missing(), opening_pause.count(), unreadable_);
  }
  services_->troubles->set(component_, topics_part, text);
}

void SpoutPlacement::report() {
  show_missing();
  if (units_.readers() == 0) {  // nobody asks any more
    arrivals_->look({});
    if (units_.list_read_here(read_units_)) arrivals_->set_units(read_units_);
  }
  services_->metrics
      ->gauge("iotcloud_spout_channels", "Channels that this worker reads; of split topics, partitions", labels())
      .set(static_cast<std::int64_t>(units_.readers()));
}

}  // namespace iotcloud::topology
