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
class EmittingLane;
class Task;

/// An input of a bolt that reads a stream: the bolt's tasks, and the grouping that chooses among them.
struct Edge {
  std::unique_ptr<Grouping> grouping;         ///< null: a direct stream, or a single task that gets every tuple
  const std::vector<int>* targets = nullptr;  ///< ascending task ids; outlives the edge
  bool custom = false;                        ///< a user's grouping, whose choices are checked
};

/// A stream that a component emits, with all that read it.
struct OutStream {
  const detail::StreamInfo* info = nullptr;
  bool direct = false;
  std::vector<Edge> edges;
};

/// Finds the receivers of the tuples that one task emits, and puts the tuples on the task's lane. Used only in the
/// task's own calls: first choose(), then send().
class Emitter {
 public:
  /// \param tasks index: task id; must outlive the emitter. \param self the emitting task.
  void set_up(std::vector<OutStream> streams, const std::vector<BoltTask*>* tasks, const Task* self);

  /// Checks the arguments and chooses the receivers. \throws std::invalid_argument when stream, task or values do not
  /// fit. \param direct_task the receiving task, for emit_direct; -1: the groupings choose.
  void choose(std::string_view stream, const Values& values, int direct_task) {
    // The usual case: the stream's name is the very constant (no characters are compared), and one task gets all
    // tuples.
    if (stream.data() == default_stream && to_one_ != nullptr && direct_task < 0 && values.size() == to_one_->arity) {
      stream_ = to_one_;
      chosen_count_ = 1;
    } else {
      choose_among(stream, values, direct_task);
    }
  }
  std::size_t chosen() const { return chosen_count_; }  ///< number of receivers that choose() found
  bool is_sink() const { return streams_.empty(); }
  /// Makes the tuple and puts it on the lane for the receivers that choose() found. \pre there is at least one.
  /// \param trees to which the tuple belongs; empty: it is not tracked.
  /// \return XOR of the ids of its deliveries (0 when not tracked).
  std::uint64_t send(EmittingLane& lane, Values&& values, std::span<Tree* const> trees, std::int64_t born_ns);
  /// Makes the tuple of the last choose(), untracked, with one handle.
  TupleCell* make_cell(Values&& values, std::int64_t born_ns) const;

 private:
  struct Stream {
    OutStream out;
    std::size_t arity = 0;     ///< number of fields
    BoltTask* only = nullptr;  ///< the one task that gets every tuple of the stream; null: the receivers must be chosen
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
  // Results of the last choose():
  const Stream* stream_ = nullptr;
  std::size_t chosen_count_ = 0;
  std::vector<int> chosen_;  ///< not set when the stream has an `only`
};

}  // namespace iotcloud::topology::internal
