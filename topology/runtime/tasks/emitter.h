#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include <iotcloud/topology/grouping.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

class BoltTask;
class Lane;

/// One reader of a stream: a component and the grouping that chooses among its tasks.
struct Edge {
  std::unique_ptr<Grouping> grouping;         ///< null: direct, or a single task that gets all
  const std::vector<int>* targets = nullptr;  ///< ascending task ids; outlives the edge
  bool custom = false;                        ///< a user's grouping: what it chooses is checked
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
  void choose(std::string_view stream, const Values& values, int direct_task) {
    // The usual case without looking at the letters: this very constant, and one task that gets it all.
    if (stream.data() == default_stream && to_one_ != nullptr && direct_task < 0 && values.size() == to_one_->arity) {
      stream_ = to_one_;
      chosen_count_ = 1;
    } else {
      choose_among(stream, values, direct_task);
    }
  }
  std::size_t chosen() const { return chosen_count_; }
  bool is_sink() const { return streams_.empty(); }
  /// Makes the tuple for the receivers that choose() found; at least one. It is tracked when `trees` is not empty.
  /// \return XOR of the ids of its deliveries (0 when not tracked).
  std::uint64_t send(Lane& lane, Values&& values, std::span<Tree* const> trees, std::int64_t born_ns);
  /// The tuple that send() would make, for a single handle; untracked.
  TupleCell* make_cell(Values&& values, std::int64_t born_ns) const;

 private:
  struct Stream {
    OutStream out;
    std::size_t arity = 0;     ///< number of fields
    BoltTask* only = nullptr;  ///< whatever is emitted, this one task gets it
  };
  void choose_among(std::string_view stream, const Values& values, int direct_task);
  Stream& find(std::string_view name);
  void choose_by_groupings(Stream& stream, const Values& values);
  void choose_direct(const Stream& stream, int task);

  std::vector<Stream> streams_;
  Stream* default_ = nullptr;       ///< the default stream
  const Stream* to_one_ = nullptr;  ///< the default stream, if it has an `only`
  const std::vector<BoltTask*>* tasks_ = nullptr;
  const Task* self_ = nullptr;
  // Of the last choose():
  const Stream* stream_ = nullptr;
  std::size_t chosen_count_ = 0;
  std::vector<int> chosen_;  ///< unless the stream has an `only`
};

}  // namespace iotcloud::topology::internal
