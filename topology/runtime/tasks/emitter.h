#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/topology/grouping.h>
#include <iotcloud/topology/runtime/runtime.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

class BoltTask;
class EmittingLane;
class Task;

/// Whether a stream's name is that of the default stream. What is linked with the runtime gives the very constant, as a
/// rule; a component library that is loaded has a copy of its characters.
[[gnu::always_inline]] inline bool is_default(std::string_view stream) {
  constexpr std::size_t size = std::char_traits<char>::length(default_stream);
  return stream.data() == default_stream ||
         (stream.size() == size && std::memcmp(stream.data(), default_stream, size) == 0);
}

/// A task that gets tuples, with its id, which the emitting lane needs first.
struct Receiver {
  BoltTask* task = nullptr;
  std::size_t id = 0;
};

/// An input of a bolt that reads a stream: the bolt's tasks, and the grouping that chooses among them.
struct Edge {
  std::unique_ptr<Grouping> grouping;         ///< null: a direct stream, or a single task that gets every tuple
  const std::vector<int>* targets = nullptr;  ///< ascending task ids; outlives the edge
  bool custom = false;                        ///< a user's grouping, whose choices are checked
};

/// Counts of one of several streams of a task. The thread that runs the task writes them, any thread reads them.
struct StreamCounts {
  std::atomic<std::uint64_t> emitted{0}, transferred{0};
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

  struct Stream {
    OutStream out;
    std::size_t arity = 0;  ///< number of fields
    // If each tuple of the stream goes to one task. Thousands of tasks may have thousands of receivers each, so what
    // lists these is shared.
    Receiver only;                              ///< the receiver, if there is one
    detail::ToOneGrouping* grouping = nullptr;  ///< chooses among several; null: there is one, or the stream is another
    const int* targets = nullptr;               ///< if `grouping`: the ids of the tasks among which it chooses
    BoltTask* const* tasks = nullptr;           ///< index: task id
    StreamCounts* counts = nullptr;             ///< null: it has what the task emits and no other stream counts
    bool to_one() const { return only.task != nullptr || grouping != nullptr; }
    /// \pre to_one().
    [[gnu::always_inline]] Receiver choose(const Values& values) const {
      if (grouping == nullptr) return only;
      const auto id = static_cast<std::size_t>(targets[grouping->place(values)]);
      return {tasks[id], id};
    }
  };

  /// An emit to the default stream, every tuple of which goes to one task. It does in one step, in few instructions,
  /// what choose() and send() do in two. \return null: the emit is another one. Otherwise the stream, for send_usual().
  [[gnu::always_inline]] const Stream* usual(std::string_view stream, const Values& values, int direct_task) const {
    return is_default(stream) && direct_task == -1 && values.size() == usual_arity_ ? usual_ : nullptr;
  }
  /// Makes the tuple and puts it on the lane; defined in send.h. \param tree null: it is not tracked. \param id of its
  /// delivery, if it is. \return the tuple, which is the lane's until the next flush.
  TupleCell* send_usual(const Stream& usual, EmittingLane& lane, Values&& values, std::int64_t born_ns, Tree* tree,
                        std::uint64_t id);

  /// Checks the arguments and chooses the receivers. \throws std::invalid_argument when stream, task or values do not
  /// fit. \param direct_task the receiving task, for emit_direct; -1: the groupings choose.
  void choose(std::string_view stream, const Values& values, int direct_task);
  std::size_t chosen() const { return chosen_.size(); }  ///< number of receivers that choose() found
  /// Counts the tuple of the last choose() as one of its stream.
  void count_for_stream() const {
    if (stream_->counts == nullptr) return;
    auto& [emitted, transferred] = *stream_->counts;
    emitted.store(emitted.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
    transferred.store(transferred.load(std::memory_order_relaxed) + chosen(), std::memory_order_relaxed);
  }
  /// Each stream's part of what the task emitted and transferred; empty: there are not several. Any thread.
  std::vector<StreamSnapshot> counts(std::uint64_t emitted, std::uint64_t transferred) const;
  bool is_sink() const { return streams_.empty(); }
  /// Makes the tuple and puts it on the lane for the receivers that choose() found. \pre there is at least one.
  /// \param trees to which the tuple belongs; empty: it is not tracked.
  /// \return XOR of the ids of its deliveries (0 when not tracked).
  std::uint64_t send(EmittingLane& lane, Values&& values, std::span<Tree* const> trees, std::int64_t born_ns);
  /// Makes the tuple of the last choose(), untracked, with one handle.
  TupleCell* make_cell(TupleCell::Recycled& recycled, Values&& values, std::int64_t born_ns) const;

 private:
  TupleCell* make_cell(TupleCell::Recycled& recycled, const Stream& stream, Values&& values,
                       std::int64_t born_ns) const;
  Receiver receiver(int task) const;
  Stream& find(std::string_view name);
  void choose_by_groupings(Stream& stream, const Values& values);
  void choose_direct(const Stream& stream, int task);
  std::vector<Stream> streams_;
  std::unique_ptr<StreamCounts[]> counts_;  ///< null: there are not several streams
  Stream* default_ = nullptr;               ///< the default stream
  const Stream* usual_ = nullptr;           ///< the default stream, if it is to_one()
  std::size_t usual_arity_ = no_usual;      ///< its number of fields
  static constexpr std::size_t no_usual = ~std::size_t{0};
  const std::vector<BoltTask*>* tasks_ = nullptr;
  int source_task_ = 0;  ///< id of the emitting task
  const Task* self_ = nullptr;
  // Results of the last choose():
  const Stream* stream_ = nullptr;
  std::vector<Receiver> chosen_;
  std::vector<int> ids_;  ///< only used in choose(); a member, to keep its memory
};

}  // namespace iotcloud::topology::internal
