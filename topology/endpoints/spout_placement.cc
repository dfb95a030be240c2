#include <algorithm>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/fair_shares.h>
#include <iotcloud/topology/endpoints/spout_placement.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};

/// Units that come or go within so short a time are shared out together.
constexpr std::chrono::milliseconds gathering{5};

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
  discovery::GuardPtr workers;
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
    workers_ = {services_->worker};
    loads_.assign(inboxes_.size(), 0);
  }
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
  search->workers = registry.watch_children(services_->paths.workers(services_->topology), [this](const auto& names) {
    in_turn([&] { on_workers(names.value_or(std::vector<std::string>())); });
  });
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
  discovery::GuardPtr sharing;
  discovery::GuardPtr anew;
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(over_, true)) return;
    units.swap(units_);
    sharing.swap(sharing_);
    anew.swap(anew_);
    inboxes_.clear();
  }
  search_.reset();
  sharing.reset();
  anew.reset();
  for (auto& [name, unit] : units) {
    stop_reading(unit);
    unit.election.reset();
  }
}

template <typename Function>
void SpoutPlacement::in_turn(Function function) {
  std::vector<std::unique_ptr<discovery::Election>> dying;  // outside the lock: they wait for their callbacks
  const std::lock_guard lock(mutex_);
  if (over_) return;
  function();
  dying.swap(resigned_);
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
  unit.channels[channel.instance] = channel;
  if (fresh && workers_.size() == 1) stand(name, unit);
  if (fresh && workers_.size() > 1) share_out_soon();
  if (unit.task >= 0) read(unit);
  report();
}

void SpoutPlacement::on_channel_gone(const discovery::ChannelRecord& channel) {
  const auto found = units_.find(unit_of(channel));
  if (found == units_.end() || found->second.channels.erase(channel.instance) == 0) return;
  if (!found->second.channels.empty()) {
    if (found->second.task >= 0) read(found->second);
  } else {
    release(found->second);
    units_.erase(found);
    share_out_soon();
  }
  report();
}

void SpoutPlacement::on_workers(const std::vector<std::string>& workers) {
  workers_ = workers;
  // Not listed yet, or not any more while the session is renewed: this worker counts all the same.
  if (std::find(workers_.begin(), workers_.end(), services_->worker) == workers_.end()) {
    workers_.push_back(services_->worker);
  }
  share_out();
  balance();
  report();
}

void SpoutPlacement::share_out_soon() {
  if (std::exchange(sharing_soon_, true)) return;
  sharing_ = services_->registry->after(gathering, [this] {
    in_turn([&] {
      sharing_soon_ = false;
      share_out();
      balance();
      report();
    });
  });
}

void SpoutPlacement::share_out() {
  if (workers_.size() == 1) {
    for (auto& [name, unit] : units_) stand(name, unit);
    return;
  }
  std::vector<std::string> names;
  for (const auto& [name, unit] : units_) names.push_back(name);
  const auto shares = fair_shares(std::move(names), workers_);
  for (auto& [name, unit] : units_) {
    if (shares.at(name) == services_->worker) {
      stand(name, unit);
    } else if (unit.election && !unit.frozen) {
      release(unit);
    }
  }
}

void SpoutPlacement::stand(const std::string& name, Unit& unit) {
  if (unit.election) return;
  discovery::Election::Callbacks callbacks;
  callbacks.on_elected = [this, name](std::int64_t) { in_turn([&] { on_elected(name); }); };
  callbacks.on_lost = [this, name] { in_turn([&] { on_lost(name); }); };
  unit.election = std::make_unique<discovery::Election>(
      *services_->registry, services_->paths.topology(services_->topology) + "/readers/" + component_ + "/" + name,
      services_->worker, std::move(callbacks), discovery::Succession::whoever_is_first);
}

void SpoutPlacement::on_elected(const std::string& name) {
  const auto found = units_.find(name);
  if (found == units_.end()) return;
  Unit& unit = found->second;
  unit.leads = true;
  unit.frozen = false;
  if (unit.task < 0) {
    unit.task = static_cast<int>(std::min_element(loads_.begin(), loads_.end()) - loads_.begin());
    ++loads_[static_cast<std::size_t>(unit.task)];
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
  stop_reading(unit);
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
    if (std::exchange(unit.frozen, false) && !unit.leads) stop_reading(unit);
  }
  share_out();
  balance();
  report();
}

/// After the fence was put up: what comes from here on comes from a place that the broker has confirmed.
void SpoutPlacement::subscribe_anew() {
  for (auto& [name, unit] : units_) {
    if (unit.task < 0) continue;
    for (const auto& [key, reader] : unit.readers) reader->close();
    reader_count_ -= unit.readers.size();
    unit.readers.clear();
    read(unit);
  }
}

/// First the readers, then the right to read: the next reader finds the topic free.
void SpoutPlacement::release(Unit& unit) {
  stop_reading(unit);
  if (unit.election) resigned_.push_back(std::move(unit.election));
  unit.leads = false;
  unit.frozen = false;
}

void SpoutPlacement::stop_reading(Unit& unit) {
  for (const auto& [key, reader] : unit.readers) reader->close();
  reader_count_ -= unit.readers.size();
  unit.readers.clear();
  if (unit.task >= 0) --loads_[static_cast<std::size_t>(unit.task)];
  unit.task = -1;
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
  options.group = services_->topology;
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

/// Moves units from the busiest task to the idlest while they differ by more than one.
void SpoutPlacement::balance() {
  for (;;) {
    const auto [least, most] = std::minmax_element(loads_.begin(), loads_.end());
    if (*most - *least <= 1) return;
    const int from = static_cast<int>(most - loads_.begin());
    const int to = static_cast<int>(least - loads_.begin());
    const auto moved =
        std::find_if(units_.begin(), units_.end(), [&](const auto& entry) { return entry.second.task == from; });
    stop_reading(moved->second);
    moved->second.task = to;
    ++loads_[static_cast<std::size_t>(to)];
    read(moved->second);
  }
}

void SpoutPlacement::report() {
  services_->metrics
      ->gauge("iotcloud_spout_channels", "Channels that this worker reads",
              {{"topology", services_->topology}, {"component", component_}})
      .set(static_cast<std::int64_t>(reader_count_));
}

}  // namespace iotcloud::topology
