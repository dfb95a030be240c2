#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include <iotcloud/topology/windows/windowed_bolt.h>

namespace iotcloud::topology::internal {

/// Keeps tuples in order of time and cuts windows out of them. It has no clock: advance() tells it the time. Not thread
/// safe.
class WindowBuffer {
 public:
  /// Receives windows and released tuples. For each tuple either done() or failed() is called once.
  class Listener {
   public:
    virtual ~Listener() = default;
    /// \return false if the window failed, and its tuples with it.
    virtual bool evaluate(const TupleWindow& window) = 0;
    virtual void done(const Tuple& tuple) = 0;
    virtual void failed(const Tuple& tuple) = 0;
  };

  /// \param origin_ms windows end at this plus multiples of the slide.
  WindowBuffer(WindowExtent length, WindowExtent slide, std::int64_t origin_ms);

  /// \pre `time_ms` is not before the last advance().
  void add(std::int64_t time_ms, const Tuple& tuple);
  /// Evaluates the complete windows in order. No tuple before `time_ms` may be added afterwards.
  void advance(std::int64_t time_ms, Listener& listener);
  std::size_t size() const { return entries_.size(); }

 private:
  struct Entry {
    std::int64_t time_ms;
    Tuple tuple;
    bool seen;  ///< a window contained it
  };
  void advance_by_count(std::int64_t time_ms, Listener& listener);
  void advance_by_time(std::int64_t time_ms, Listener& listener);
  /// The next end of a window that may hold other tuples than the window that ended at `end`.
  std::optional<std::int64_t> next_end(std::int64_t end, std::int64_t time_ms) const;
  std::int64_t end_after(std::int64_t time_ms) const;  ///< the first end after `time_ms`
  std::size_t first_not_before(std::int64_t time_ms) const;
  /// Evaluates the window of the entries [from, to), and releases the entries before `from`. \return false if it
  /// failed.
  bool evaluate(std::size_t from, std::size_t to, std::int64_t end_ms, Listener& listener);
  void drop_first(std::size_t count, Listener& listener);

  const WindowExtent length_;
  const WindowExtent slide_;
  const std::int64_t origin_ms_;
  std::deque<Entry> entries_;  ///< by time, then arrival
  std::int64_t dropped_ = 0;   ///< number of entries released before the first one
  std::int64_t next_count_;    ///< slide by count: the next window ends after this many entries, released ones included
  std::optional<std::int64_t> next_end_;  ///< slide by time: the next end to evaluate
  std::vector<Tuple> expired_;            ///< released since the last window
  std::vector<Tuple> tuples_, added_;     ///< used by evaluate(); members, to keep their memory
};

}  // namespace iotcloud::topology::internal
