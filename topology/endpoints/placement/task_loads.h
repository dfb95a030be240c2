#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

namespace iotcloud::topology {

/// The kinds of units of placement.
enum class UnitKind : std::size_t {
  gateway,   ///< a driver on a gateway, with a shared channel, or one partition of that
  instance,  ///< a driver instance, with a channel of its own
};
inline constexpr std::size_t unit_kinds = 2;

/// Counts the units that each task of a spout reads in one worker, and says how to even them out. Not thread safe.
class TaskLoads {
 public:
  explicit TaskLoads(std::size_t tasks = 0) : loads_(tasks) {}

  /// The task that should get the next unit of this kind.
  std::size_t idlest(UnitKind kind) const;
  void add(std::size_t task, UnitKind kind) { ++at(task, kind); }
  void remove(std::size_t task, UnitKind kind) { --at(task, kind); }

  struct Move {
    UnitKind kind;
    std::size_t from, to;
  };
  /// The next move that evens the loads out; nullopt when the numbers of units of any two tasks differ by one at most,
  /// for each kind and in all. A caller that makes each move reaches that state.
  std::optional<Move> next_move() const;

 private:
  std::size_t& at(std::size_t task, UnitKind kind) { return loads_[task][static_cast<std::size_t>(kind)]; }
  std::size_t of(std::size_t task, UnitKind kind) const { return loads_[task][static_cast<std::size_t>(kind)]; }
  std::size_t total(std::size_t task) const { return loads_[task][0] + loads_[task][1]; }

  std::vector<std::array<std::size_t, unit_kinds>> loads_;  ///< by task
};

}  // namespace iotcloud::topology
