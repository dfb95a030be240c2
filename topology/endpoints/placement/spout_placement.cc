#include <algorithm>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/placement/spout_placement.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};

/// Units that are taken or given up within so short a time stand in one line of the log.
constexpr std::chrono::seconds gathering_for_the_log{1};

/// A driver instance for an exclusive channel, a gateway for a shared one.
std::string unit_of(const discovery::ChannelRecord& channel) {
  return channel.shared ? "gateway-" + channel.gateway : "instance-" + channel.instance;
}

}  // namespace

struct SpoutPlacement::Search {
  explicit Search(Fence& f) : fence(f) {}
  ~Search() { fence.ignore(listener); }
  Search(const Search&) = delete;
  Search& operator=(const Search&) = delete;

  Fence& fence;
  int listener = 0;
  discovery::GuardPtr session;
  std::unique_ptr<ReadingGroup> group;
  std::unique_ptr<discovery::DriverDirectory> directory;
};

SpoutPlacement::SpoutPlacement(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint)
    : services_(std::move(services)), component_(std::move(component)), endpoint_(std::move(endpoint)) {}

SpoutPlacement::~SpoutPlacement() = default;

void SpoutPlacement::join(int task_index, int task_count, std::shared_ptr<Inbox> inbox) {
  {
    const std::lock_guard lock(mutex_);
    inboxes_[task_index] = std::move(inbox);
    if (inboxes_.size() < static_cast<std::size_t>(task_count)) return;
    loads_ = TaskLoads(inboxes_.size());
  }
  path_ = readers_path(endpoint_, *services_);
  // Callbacks come on the dispatcher and wait for mutex_: it is not held here, nor in leave() while the watches die.
  auto& registry = *services_->registry;
  auto search = std::make_unique<Search>(*services_->fence);
  search->listener = services_->fence->listen([this] {
    discovery::GuardPtr before;  // dies outside the lock: its callback may be waiting for it
    const std::lock_guard lock(mutex_);
    if (over_) return;
    before = std::exchange(anew_, services_->registry->after(std::chrono::milliseconds(0),
                                                             [this] { in_turn([&] { subscribe_anew(); }); }));
  });
  search->session = registry.on_session([this](discovery::SessionState state) { in_turn([&] { on_session(state); }); });
  ReadingGroup::Member self;
  self.sharer = {services_->worker, task_count};
  self.topology = services_->topology;
  self.shares = !endpoint_.group.empty();
  self.broker = endpoint_.broker;
  self.where = endpoint_.where.everything() ? "" : endpoint_.where.text();
  self.since_ms = services_->clock->wall_ms();
  search->group = std::make_unique<ReadingGroup>(
      registry, path_, std::move(self),
      [this](const auto& sharers, const std::string& problem) { in_turn([&] { on_sharers(sharers, problem); }); });
  discovery::DriverDirectory::Callbacks callbacks;
  callbacks.on_channel = [this](const discovery::ChannelRecord& channel) { in_turn([&] { on_channel(channel); }); };
  callbacks.on_channel_gone = [this](const discovery::ChannelRecord& channel) {
    in_turn([&] { on_channel_gone(channel); });
  };
  if (!endpoint_.where.everything()) {
    callbacks.on_verdict = [this](const std::string& instance, std::optional<bool> chosen) {
      verdicts_->told(instance, chosen);
    };
  }
  search->directory = std::make_unique<discovery::DriverDirectory>(
      registry, services_->paths, endpoint_.driver, endpoint_.channel, std::move(callbacks), endpoint_.where);
  search_ = std::move(search);
}

void SpoutPlacement::leave() {
  std::map<std::string, Unit> units;
  discovery::GuardPtr sharing, telling, anew, looking;
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(over_, true)) return;
    units.swap(units_);
    sharing.swap(sharing_);
    anew.swap(anew_);
    telling.swap(telling_);
    looking.swap(looking_);
    inboxes_.clear();
  }
  search_.reset();
  sharing.reset();
  anew.reset();
  telling.reset();
  looking.reset();
  for (auto& [name, unit] : units) {
    close_readers(unit);
    unit.election.reset();
  }
}

bool SpoutPlacement::fits(const discovery::ChannelRecord& channel) {
  std::string problem;
  if (channel.direction != discovery::Direction::out) {
    problem = "it brings messages to the driver, so there is nothing to read";
  } else if (channel.transport != endpoint_.broker) {
    problem =
        "it goes over the broker \"" + channel.transport + "\", and the topology says \"" + endpoint_.broker + "\"";
  } else if (topic_of(channel).name.empty()) {
    problem = "its record names no topic";
  }
  if (problem.empty()) return true;
  if (complained_.insert(channel.gateway + problem).second) {
    logger.warn("{}: channel {} of driver {} on gateway {} is not read: {}", component_, channel.name, channel.driver,
                channel.gateway, problem);
  }
  return false;
}

void SpoutPlacement::on_channel(const discovery::ChannelRecord& channel) {
  if (!fits(channel)) {
    on_channel_gone(channel);
    return;
  }
  const std::string name = unit_of(channel);
  const bool fresh = !units_.contains(name);
  Unit& unit = units_[name];
  unit.kind = channel.shared ? UnitKind::gateway : UnitKind::instance;
  unit.channels[channel.instance] = channel;
  if (fresh && alone()) stand(name, unit);
  if (fresh && !alone()) share_out_soon();
  if (unit.task >= 0) read(unit);
  report();
}

void SpoutPlacement::on_channel_gone(const discovery::ChannelRecord& channel) {
  const auto found = units_.find(unit_of(channel));
  if (found == units_.end() || found->second.channels.erase(channel.instance) == 0) return;
  if (!found->second.channels.empty()) {
    if (found->second.task >= 0) read(found->second);
  } else {
    release(found->first, found->second);
    units_.erase(found);
    share_out_soon();
  }
  report();
}

void SpoutPlacement::on_sharers(const std::vector<Sharer>& sharers, const std::string& problem) {
  if (problem != problem_ && !problem.empty()) {
    logger.error("{}: channel {} of driver {} is not read here: {}", component_, endpoint_.channel, endpoint_.driver,
                 problem);
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
    logger.debug("{}: {} is read here, by task {}", component_, name, task);
  }
  read(unit);
  report();
}

void SpoutPlacement::on_lost(const std::string& name) {
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

/// The registry is back: what was kept without it is given up unless it was won again already. When it drops the
/// session, others are elected, and have what was in hand here if the broker, too, cannot be reached.
void SpoutPlacement::on_session(discovery::SessionState state) {
  if (state == discovery::SessionState::expired) {
    const bool cut_off = std::any_of(units_.begin(), units_.end(), [](const auto& entry) {
      const auto& readers = entry.second.readers;
      return std::any_of(readers.begin(), readers.end(), [](const auto& reader) { return !reader.second->active(); });
    });
    if (cut_off) services_->fence->put_up();
  }
  if (state != discovery::SessionState::connected) return;
  for (auto& [name, unit] : units_) {
    if (std::exchange(unit.frozen, false) && !unit.leads) stop_reading(name, unit);
  }
  share_out();
  balance();
  report();
}

/// After the fence was put up: what comes from here on comes from a place that the broker has confirmed.
void SpoutPlacement::subscribe_anew() {
  for (auto& [name, unit] : units_) {
    if (unit.task < 0) continue;
    close_readers(unit);
    read(unit);
  }
}

void SpoutPlacement::stop_reading(const std::string& name, Unit& unit) {
  close_readers(unit);
  unit.move = Move::none;
  if (unit.task < 0) return;
  loads_.remove(static_cast<std::size_t>(unit.task), unit.kind);
  unit.task = -1;
  ++given_up_;
  tell_soon();
  logger.debug("{}: {} is read here no longer", component_, name);
}

void SpoutPlacement::close_readers(Unit& unit) {
  for (const auto& [key, reader] : unit.readers) reader->close();
  reader_count_ -= unit.readers.size();
  unit.readers.clear();
}

/// Makes the unit's readers those that its channels want.
void SpoutPlacement::read(Unit& unit) {
  std::map<ReaderKey, const discovery::ChannelRecord*> wanted;
  for (const auto& [instance, channel] : unit.channels) {
    wanted.emplace(ReaderKey(address_of(channel, *services_), topic_of(channel)), &channel);
  }
  for (auto place = unit.readers.begin(); place != unit.readers.end();) {
    if (wanted.contains(place->first)) {
      ++place;
      continue;
    }
    place->second->close();
    place = unit.readers.erase(place);
    --reader_count_;
  }
  if (unit.move != Move::none) return;  // opened where it goes
  for (const auto& [key, channel] : wanted) {
    if (unit.readers.contains(key)) continue;
    if (auto reader = open_reader(*channel, key, unit.task)) {
      unit.readers[key] = std::move(reader);
      ++reader_count_;
    }
  }
}

std::shared_ptr<ChannelReader> SpoutPlacement::open_reader(const discovery::ChannelRecord& channel,
                                                           const ReaderKey& key, int task) {
  brokers::SubscriptionOptions options;
  options.group = group_of(endpoint_, *services_);
  options.automatic_ack = endpoint_.reading.automatic_ack;
  options.prefetch = static_cast<std::uint16_t>(endpoint_.reading.prefetch);
  options.keep_last = static_cast<std::size_t>(endpoint_.reading.keep_last);
  options.priority = priority_of(channel);
  try {
    return ChannelReader::open(broker_at(key.first, *services_), key.first, key.second, options,
                               channel.shared ? "" : channel.instance, inboxes_.at(task), services_->fence);
  } catch (const config::Error& error) {
    if (complained_.insert(key.first.urls.front()).second) {
      logger.error("{}: {} cannot be read: {}", component_, key.second.name, error.what());
    }
    return nullptr;
  }
}

void SpoutPlacement::report() {
  services_->metrics
      ->gauge("iotcloud_spout_channels", "Channels that this worker reads",
              {{"topology", services_->topology}, {"component", component_}})
      .set(static_cast<std::int64_t>(reader_count_));
}

/// Units come by the thousand: one line in the log for all of them.
void SpoutPlacement::tell_soon() {
  if (std::exchange(telling_soon_, true)) return;
  telling_ = services_->registry->after(gathering_for_the_log, [this] {
    in_turn([&] {
      telling_soon_ = false;
      const auto read =
          std::count_if(units_.begin(), units_.end(), [](const auto& unit) { return unit.second.task >= 0; });
      logger.info("{}: units taken {}, given up {}; {} of {} are read here", component_, std::exchange(taken_, 0),
                  std::exchange(given_up_, 0), read, units_.size());
    });
  });
}

}  // namespace iotcloud::topology
