#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include <iotcloud/topology/grouping.h>
#include <iotcloud/topology/runtime/tracking.h>

namespace iotcloud::topology::internal {

class BoltTask;
class Lane;

/// One reader of a stream: a component and the grouping that chooses among its tasks.
struct Edge {
  std::unique_ptr<Grouping> grouping;  ///< null: direct
  std::vector<int> targets;            ///< ascending task ids
};

struct OutStream {
  const detail::StreamInfo* info = nullptr;
  bool direct = false;
  std::vector<Edge> edges;
};

/// The way out of one task: finds the receivers of what it emits and puts it on the lane. Only used in the task's
/// calls.
class Emitter {
 public:
  /// \param tasks by id; outlives the emitter. \param self the emitting task.
  void set_up(std::vector<OutStream> streams, const std::vector<BoltTask*>* tasks, const Task* self);

  /// Checks, and chooses the receivers. \throws std::invalid_argument when stream, task or values do not fit.
  /// \param direct_task -1: by the groupings.
  void choose(const std::string& stream, const Values& values, int direct_task);
  std::size_t chosen() const { return chosen_.size(); }
  /// Makes the tuple for the receivers that choose() found; at least one. It is tracked when `trees` is not empty.
  /// \return XOR of the ids of its deliveries (0 when not tracked).
  std::uint64_t send(Lane& lane, Values&& values, std::span<Tree* const> trees);

 private:
  std::vector<OutStream> streams_;
  const std::vector<BoltTask*>* tasks_ = nullptr;
  const Task* self_ = nullptr;
  const OutStream* stream_ = nullptr;  ///< of the last choose()
  std::vector<int> chosen_;
};

}  // namespace iotcloud::topology::internal
