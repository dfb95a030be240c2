#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace iotcloud::topology {

/// One worker among those that share units.
struct Sharer {
  std::string worker;
  int tasks = 1;  ///< at least 1: how many are to have equal shares there
  friend bool operator==(const Sharer&, const Sharer&) = default;
};

/// Spreads units of several kinds over workers: each worker can give each of its tasks as many as any other task
/// anywhere has, or one less, of every kind and in all. Every process that sees the same names comes to the same
/// answer. Workers with equal numbers of tasks get the same units whatever that number is. When a unit or a worker
/// comes or goes, few units move (rendezvous hashing with bounded loads). \param kinds names of units, all different.
/// \param sharers at least one, all with different names. \return for each unit, as it stands in `kinds`, the place of
/// its worker in `sharers`.
std::vector<std::vector<std::size_t>> fair_shares(const std::vector<std::vector<std::string>>& kinds,
                                                  const std::vector<Sharer>& sharers);

}  // namespace iotcloud::topology
