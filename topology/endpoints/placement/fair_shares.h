#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace iotcloud::topology {

/// A worker that gets a share of the units.
struct Sharer {
  std::string worker;
  int tasks = 1;  ///< number of its spout tasks, at least 1; all tasks of all workers get equal shares
  friend bool operator==(const Sharer&, const Sharer&) = default;
};

/// Spreads units of several kinds over workers. A worker can spread its units over its tasks so that the numbers of
/// units of any two tasks, in all workers, differ by one at most, for every kind and in all. The answer depends on the
/// arguments only, so every process that sees the same names comes to the same answer. If all workers have the same
/// number of tasks, that number does not change the answer. When a unit or a worker comes or goes, few units move
/// (rendezvous hashing with bounded loads). \param kinds for each kind the names of its units, all different. \param
/// sharers at least one, all with different names. \return in the order of `kinds`, for each unit the index of its
/// worker in `sharers`.
std::vector<std::vector<std::size_t>> fair_shares(const std::vector<std::vector<std::string>>& kinds,
                                                  const std::vector<Sharer>& sharers);

}  // namespace iotcloud::topology
