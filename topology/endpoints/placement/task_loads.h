#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

namespace iotcloud::topology {

/// What is placed on a spout task as one.
enum class UnitKind : std::size_t {
  gateway,   ///< a driver on a gateway, with a shared channel
  instance,  ///< a driver instance, with a channel of its own
};
inline constexpr std::size_t unit_kinds = 2;

/// How many units each task of a spout reads in one worker, and how to even them out. Not thread safe.
class TaskLoads {
 public:
  explicit TaskLoads(std::size_t tasks = 0) : loads_(tasks) {}

  /// The task that is to get one more.
  std::size_t idlest(UnitKind kind) const;
  void add(std::size_t task, UnitKind kind) { ++at(task, kind); }
  void remove(std::size_t task, UnitKind kind) { --at(task, kind); }

  struct Move {
    UnitKind kind;
    std::size_t from, to;
  };
  /// A unit that should move; none when no task has more than one more than another, of each kind and in all. Moving as
  /// it says comes to an end.
  std::optional<Move> next_move() const;

 private:
  std::size_t& at(std::size_t task, UnitKind kind) { return loads_[task][static_cast<std::size_t>(kind)]; }
  std::size_t of(std::size_t task, UnitKind kind) const { return loads_[task][static_cast<std::size_t>(kind)]; }
  std::size_t total(std::size_t task) const { return loads_[task][0] + loads_[task][1]; }

  std::vector<std::array<std::size_t, unit_kinds>> loads_;  ///< by task
};

}  // namespace iotcloud::topology
