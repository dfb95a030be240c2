// Who reads which unit: fair shares among the workers, and even loads of this worker's tasks.
#include <algorithm>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/placement/fair_shares.h>
#include <iotcloud/topology/endpoints/placement/spout_placement.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};

/// Units that come or go within so short a time are shared out together.
constexpr std::chrono::milliseconds gathering{5};

}  // namespace

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
        release(name, unit);  // there is nothing to drain
      } else if (unit.election && !unit.frozen) {
        move(name, unit, Move::to_worker);
      }
    }
  }
}

void SpoutPlacement::stand(const std::string& name, Unit& unit) {
  if (unit.move == Move::to_worker) unit.move = Move::to_task;  // it stays after all, and begins anew when drained
  if (unit.election) return;
  discovery::Election::Callbacks callbacks;
  callbacks.on_elected = [this, name](std::int64_t) { in_turn([&] { on_elected(name); }); };
  callbacks.on_lost = [this, name] { in_turn([&] { on_lost(name); }); };
  unit.election = std::make_unique<discovery::Election>(*services_->registry, ReadingGroup::election(path_, name),
                                                        services_->worker, std::move(callbacks),
                                                        discovery::Succession::whoever_is_first);
}

/// Reading ends when what was read here is settled.
void SpoutPlacement::move(const std::string& name, Unit& unit, Move where) {
  if (unit.move == Move::none) {
    unit.looks_left = static_cast<int>(drain_limit / look_period);
    for (const auto& [key, reader] : unit.readers) reader->drain();
    moving_.insert(name);
    look_soon();
  }
  unit.move = where;
}

void SpoutPlacement::look_soon() {
  if (std::exchange(looking_soon_, true)) return;
  looking_ = services_->registry->after(look_period, [this] {
    in_turn([&] {
      looking_soon_ = false;
      look_at_moves();
      balance();
      report();
    });
  });
}

/// Ends the moves of units that are drained; of those that need too long, too: their next reader gets again what is not
/// settled then.
void SpoutPlacement::look_at_moves() {
  for (auto name = moving_.begin(); name != moving_.end();) {
    const auto found = units_.find(*name);
    const bool moves = found != units_.end() && found->second.move != Move::none;
    if (moves && found->second.looks_left-- > 0 &&
        std::any_of(found->second.readers.begin(), found->second.readers.end(),
                    [](const auto& entry) { return entry.second->has_in_hand(); })) {
      ++name;
      continue;
    }
    if (moves && found->second.move == Move::to_worker && !found->second.frozen) {
      release(*name, found->second);
    } else if (moves) {
      found->second.move = Move::none;
      close_readers(found->second);
      read(found->second);
    }
    name = moving_.erase(name);
  }
  if (!moving_.empty()) look_soon();
}

/// First the readers, then the right to read: the next reader finds the topic free.
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
    logger.debug("{}: {} moves from task {} to {}", component_, moved->first, next->from, next->to);
    move(moved->first, unit, unit.move == Move::none ? Move::to_task : unit.move);
  }
}

}  // namespace iotcloud::topology
