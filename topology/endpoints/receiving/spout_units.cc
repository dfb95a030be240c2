#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/receiving/spout_units.h>

namespace iotcloud::topology {

// Channels.

void SpoutUnits::add(const std::string& name, const discovery::ChannelRecord& channel, const UnitReaders::Key& topic,
                     std::optional<std::int32_t> partition) {
  begin_again(name);
  const auto [place, fresh] = units_.try_emplace(name, totals_);
  Unit& unit = place->second;
  unit.kind = channel.shared ? UnitKind::gateway : UnitKind::instance;
  unit.partition = partition;
  unit.channels.insert_or_assign(channel.instance, Channel{channel, topic});
  if (fresh && alone()) run_for_leader(name, unit);
  if (fresh) needs_sharing_ = true;
  if (unit.task >= 0) read(unit);
}

void SpoutUnits::remove(const std::string& name, const discovery::InstanceId& instance, End end) {
  const auto found = units_.find(name);
  if (found == units_.end() || !found->second.channels.contains(instance)) return;
  Unit& unit = found->second;
  if (unit.channels.size() > 1) {
    unit.channels.erase(instance);
    if (unit.task >= 0) read(unit);
    return;
  }
  if (end == End::when_silent && (unit.candidacy || unit.given_away)) {
    run_for_leader(name, unit);
    read_to_the_end(name);
  } else {
    release(name, unit);
    units_.erase(found);
  }
  needs_sharing_ = true;
}

void SpoutUnits::undeployed(const discovery::InstanceId& instance) {
  for (auto& [name, unit] : ending_) {
    if (unit.instance == instance) unit.undeployed = true;
  }
}

/// The last channel of a unit is gone: the unit leaves the placement, and is read to its end. If this worker does not
/// lead it, that begins with this worker's election: another one was about to give the unit up, and may have left
/// messages, or was about to take it, and may not have run for it when its channel went.
void SpoutUnits::read_to_the_end(const std::string& name) {
  Unit& unit = units_.at(name);
  if (std::exchange(unit.move, Move::none) != Move::none) open_anew(unit);  // its readers take nothing any more
  if (const auto& [instance, channel] = *unit.channels.begin(); !channel.record.shared) {
    unit.instance = instance;
    unit.topic = channel.topic;
  }
  unit.undeployed = false;
  unit.looks_left = static_cast<int>(longest_end / look_period);
  if (unit.task >= 0) {
    loads_.remove(static_cast<std::size_t>(unit.task), unit.kind);
    ++changes_.given_up;
    begin_end(unit);
  }
  ending_.insert(units_.extract(name));
}

/// The unit's readers are open, and stay so until look() has seen it idle for long enough.
void SpoutUnits::begin_end(Unit& unit) {
  unit.last_task = std::exchange(unit.task, -1);
  unit.looks_left = static_cast<int>(longest_end / look_period);
  count_anew(unit);
}

void SpoutUnits::count_anew(Unit& unit) {
  unit.idle_looks = 0;
  unit.taken = unit.readers.taken();
  unit.in_hand = unit.readers.in_hand();
}

/// A channel of a unit that ends is back: the unit is read, or run for, as before, without an interruption.
void SpoutUnits::begin_again(const std::string& name) {
  const auto ending = ending_.find(name);
  if (ending == ending_.end()) return;
  Unit& unit = ending->second;
  if (unit.waits_for_election()) {
    unit.channels.clear();  // add() has what its channel is now
    units_.insert(ending_.extract(ending));
    needs_sharing_ = true;
    return;
  }
  unit.channels.clear();
  unit.task = std::exchange(unit.last_task, -1);
  loads_.add(static_cast<std::size_t>(unit.task), unit.kind);
  ++changes_.taken;
  units_.insert(ending_.extract(ending));
  needs_sharing_ = true;
}

// Who reads which unit: fair shares among the workers, and even loads of this worker's tasks.

void SpoutUnits::share_out() {
  needs_sharing_ = false;
  UnitNames names(unit_kinds);
  for (const auto& [name, unit] : units_) names[static_cast<std::size_t>(unit.kind)].push_back(name);
  if (options_.shared_together) names = options_.shared_together(names);
  if (sharers_.empty()) return;
  if (alone()) {
    for (auto& [name, unit] : units_) run_for_leader(name, unit);
    return balance();
  }
  const auto shares = fair_shares(names, sharers_);
  for (std::size_t kind = 0; kind < names.size(); ++kind) {
    for (std::size_t i = 0; i < names[kind].size(); ++i) {
      const std::string& name = names[kind][i];
      const auto found = units_.find(name);
      if (found == units_.end()) continue;  // another spout's
      Unit& unit = found->second;
      if (sharers_[shares[kind][i]].worker == options_.worker) {
        run_for_leader(name, unit);
      } else if (unit.candidacy && unit.task < 0) {
        release(name, unit);  // no message of it is in hand
      } else if (unit.candidacy && !unit.frozen) {
        move(name, unit, Move::to_worker);
      }
    }
  }
  balance();
}

void SpoutUnits::run_for_leader(const std::string& name, Unit& unit) {
  // it stays in this worker after all, and is read again when it is drained
  if (unit.move == Move::to_worker) unit.move = Move::to_task;
  if (!unit.candidacy) unit.candidacy = options_.run_for_leader(name);
  unit.given_away = false;
}

void SpoutUnits::balance() {
  while (const auto next = loads_.next_move()) {
    const auto moved = std::find_if(units_.begin(), units_.end(), [&](const auto& entry) {
      return entry.second.kind == next->kind && entry.second.task == static_cast<int>(next->from);
    });
    Unit& unit = moved->second;
    loads_.remove(next->from, unit.kind);
    loads_.add(next->to, unit.kind);
    unit.task = static_cast<int>(next->to);
    endpoints_logger.debug("{}: {} moves from task {} to {}", options_.component, moved->first, next->from, next->to);
    move(moved->first, unit, unit.move == Move::none ? Move::to_task : unit.move);
  }
}

void SpoutUnits::on_elected(const std::string& name) {
  if (const auto ending = ending_.find(name); ending != ending_.end()) {
    Unit& unit = ending->second;
    unit.leads = true;
    unit.frozen = false;
    if (!unit.waits_for_election()) return;
    unit.task = static_cast<int>(loads_.idlest(unit.kind));
    read(unit);
    begin_end(unit);
    return;
  }
  const auto found = units_.find(name);
  if (found == units_.end()) return;
  Unit& unit = found->second;
  unit.leads = true;
  unit.frozen = false;
  if (unit.task < 0) {
    const std::size_t task = loads_.idlest(unit.kind);
    loads_.add(task, unit.kind);
    unit.task = static_cast<int>(task);
    ++changes_.taken;
    endpoints_logger.debug("{}: {} is read here, by task {}", options_.component, name, task);
  }
  read(unit);
}

void SpoutUnits::on_lost(const std::string& name, bool registry_away) {
  const auto ending = ending_.find(name);
  const auto found = units_.find(name);
  if (ending == ending_.end() && found == units_.end()) return;
  Unit& unit = ending != ending_.end() ? ending->second : found->second;
  unit.leads = false;
  if (registry_away) {
    unit.frozen = true;
    return;
  }
  stop_reading(name, unit);
  balance();
}

void SpoutUnits::registry_back() {
  for (auto* units : {&units_, &ending_}) {
    for (auto& [name, unit] : *units) {
      if (std::exchange(unit.frozen, false) && !unit.leads) stop_reading(name, unit);
    }
  }
  share_out();
  balance();
}

// Readers.

void SpoutUnits::hold_back() {
  held_back_ = true;
  for (auto& [name, unit] : units_) unit.readers.close();
  for (auto& [name, unit] : ending_) unit.readers.close();
}

void SpoutUnits::read_anew() {
  held_back_ = false;
  for (auto& [name, unit] : units_) {
    if (unit.task >= 0) open_anew(unit);
  }
  for (auto& [name, unit] : ending_) {
    if (unit.waits_for_election()) continue;
    open_anew(unit);
    count_anew(unit);
  }
}

void SpoutUnits::open_missing() {
  for (auto* units : {&units_, &ending_}) {
    for (auto& [name, unit] : *units) {
      if (unit.readers.lacks_one()) read(unit);
    }
  }
}

void SpoutUnits::open_anew(Unit& unit) {
  unit.readers.close();
  read(unit);
}

/// Closes the unit's readers that no channel needs any more, and opens those that are missing.
void SpoutUnits::read(Unit& unit) {
  UnitReaders::Wanted wanted;
  for (const auto& [instance, channel] : unit.channels) wanted.emplace(channel.topic, &channel.record);
  unit.readers.keep_only(wanted);
  if (unit.move != Move::none) return;  // look() opens them when the move is over
  if (held_back_) return;               // read_anew() opens them
  unit.readers.open_missing(wanted, [&](const discovery::ChannelRecord& channel, const UnitReaders::Key& topic) {
    return options_.open_reader(channel, topic, unit.partition, unit.task >= 0 ? unit.task : unit.last_task);
  });
}

void SpoutUnits::stop_reading(const std::string& name, Unit& unit) {
  unit.readers.close();
  unit.move = Move::none;
  unit.last_task = -1;
  if (unit.task < 0) return;
  loads_.remove(static_cast<std::size_t>(unit.task), unit.kind);
  unit.task = -1;
  ++changes_.given_up;
  endpoints_logger.debug("{}: {} is read here no longer", options_.component, name);
}

/// Gives a unit up. Closes the readers before it resigns as leader, so that the next leader finds the topic free.
void SpoutUnits::release(const std::string& name, Unit& unit) {
  stop_reading(name, unit);
  if (unit.candidacy) resigned_.push_back(std::move(unit.candidacy));
  unit.leads = false;
  unit.frozen = false;
}

void SpoutUnits::close() {
  units_.merge(ending_);  // no name is in both
  for (auto& [name, unit] : units_) {
    unit.readers.close();
    unit.candidacy.reset();
  }
  units_.clear();
}

// Moves and ends.

/// Begins to move a unit: drains its readers. look() ends the move.
void SpoutUnits::move(const std::string& name, Unit& unit, Move where) {
  if (unit.move == Move::none) {
    unit.looks_left = static_cast<int>(options_.longest_drain / look_period);
    unit.readers.drain();
    moving_.insert(name);
  }
  unit.move = where;
}

std::vector<SpoutUnits::EndedTopic> SpoutUnits::look() {
  look_at_moves();
  std::vector<EndedTopic> ended = look_at_ends();
  balance();
  return ended;
}

/// Ends the moves of units that are drained, or that were not drained in time: the broker delivers the
/// unsettled messages of the latter again to the next reader.
void SpoutUnits::look_at_moves() {
  for (auto name = moving_.begin(); name != moving_.end();) {
    const auto found = units_.find(*name);
    const bool moves = found != units_.end() && found->second.move != Move::none;
    if (moves && found->second.looks_left-- > 0 && found->second.readers.in_hand() > 0) {
      ++name;
      continue;
    }
    if (moves && found->second.move == Move::to_worker && !found->second.frozen) {
      release(*name, found->second);
      found->second.given_away = true;
    } else if (moves) {
      found->second.move = Move::none;
      open_anew(found->second);
    }
    name = moving_.erase(name);
  }
}

std::vector<SpoutUnits::EndedTopic> SpoutUnits::look_at_ends() {
  std::vector<EndedTopic> ended;
  for (auto place = ending_.begin(); place != ending_.end();) {
    auto& [name, unit] = *place;
    if (unit.waits_for_election()) {
      if (unit.looks_left-- > 0) {
        ++place;
      } else {
        release(name, unit);
        place = ending_.erase(place);
      }
      continue;
    }
    const std::size_t taken = unit.readers.taken(), in_hand = unit.readers.in_hand();
    const bool nothing_came = std::exchange(unit.taken, taken) == taken;
    const bool nothing_settled = std::exchange(unit.in_hand, in_hand) == in_hand;
    const bool idle =
        nothing_came && nothing_settled && !held_back_ && !unit.readers.lacks_one() && !unit.readers.cut_off();
    unit.idle_looks = idle ? unit.idle_looks + 1 : 0;
    const bool over = in_hand == 0 && unit.idle_looks * look_period >= end_silence;
    const bool stuck = unit.idle_looks * look_period >= stuck_limit;
    if (!over && !stuck && unit.looks_left-- > 0) {
      ++place;
      continue;
    }
    if (!over) {
      std::string why = fmt::format("for {} min messages came, or the broker was away", longest_end.count());
      if (unit.readers.lacks_one()) why = fmt::format("for {} min it could not be read", longest_end.count());
      if (stuck)
        why = fmt::format("{} message(s) were not settled for {} s", in_hand, stuck_limit / std::chrono::seconds(1));
      endpoints_logger.warn("{}: {} has stopped and was not read to its end: {}; the broker keeps the rest",
                            options_.component, name, why);
    }
    release(name, unit);
    if (unit.topic) ended.push_back({unit.instance, *unit.topic, unit.undeployed});
    place = ending_.erase(place);
  }
  return ended;
}

// What the owner asks.

std::size_t SpoutUnits::read_here() const {
  return static_cast<std::size_t>(
      std::count_if(units_.begin(), units_.end(), [](const auto& entry) { return entry.second.task >= 0; }));
}

bool SpoutUnits::list_read_here(ReadUnits& list) const {
  std::size_t listed = 0, more = 0;
  bool changed = false;
  for (const auto& [name, unit] : units_) {
    if (unit.task < 0) continue;
    if (listed == ReadUnits::most_units) {
      ++more;
      continue;
    }
    if (listed == list.units.size()) list.units.emplace_back();
    auto& place = list.units[listed++];
    if (place.task == unit.task && place.name == name) continue;  // mostly nothing has changed, and nothing is copied
    place = {name, unit.task};
    changed = true;
  }
  changed = changed || listed != list.units.size() || more != list.more;
  list.units.resize(listed);
  list.more = more;
  return changed;
}

bool SpoutUnits::cut_off() const {
  const auto is_cut_off = [](const auto& entry) { return entry.second.readers.cut_off(); };
  return std::any_of(units_.begin(), units_.end(), is_cut_off) ||
         std::any_of(ending_.begin(), ending_.end(), is_cut_off);
}

std::set<discovery::InstanceId> SpoutUnits::ending_instances() const {
  std::set<discovery::InstanceId> instances;
  for (const auto& [name, unit] : ending_) instances.insert(unit.instance);
  return instances;
}

std::size_t SpoutUnits::at_limit() const {
  std::size_t count = 0;
  for (const auto& [name, unit] : units_) count += unit.readers.at_limit();
  return count;
}

std::size_t SpoutUnits::prefetch() const {
  std::size_t most = 0;
  for (const auto& [name, unit] : units_) most = std::max(most, unit.readers.prefetch());
  return most;
}

void SpoutUnits::ask_backlog(std::size_t most) {
  auto next = units_.upper_bound(asked_last_);
  std::size_t asked = 0;
  for (std::size_t i = 0; i < units_.size() && asked < most; ++i, ++next) {
    if (next == units_.end()) next = units_.begin();
    asked += next->second.readers.ask_backlog();
    asked_last_ = next->first;
  }
}

Backlog SpoutUnits::backlog() const {
  Backlog sum;
  for (const auto& [name, unit] : units_) unit.readers.add_backlog(sum);
  return sum;
}

}  // namespace iotcloud::topology
