#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include <iotcloud/topology/windows/windowed_bolt.h>

namespace iotcloud::topology::internal {

/// Keeps tuples in order of time and cuts windows out of them. It knows no clock: advance() says how late it is.
class WindowBuffer {
 public:
  /// What becomes of windows and tuples. Each tuple is done or failed exactly once.
  class Listener {
   public:
    virtual ~Listener() = default;
    /// \return false: it failed, and its tuples with it.
    virtual bool evaluate(const TupleWindow& window) = 0;
    virtual void done(const Tuple& tuple) = 0;
    virtual void failed(const Tuple& tuple) = 0;
  };

  /// \param origin_ms ends of windows are this plus multiples of the slide.
  WindowBuffer(WindowExtent length, WindowExtent slide, std::int64_t origin_ms);

  /// \pre not before the last advance().
  void add(std::int64_t time_ms, const Tuple& tuple);
  /// Nothing that is before `time_ms` will be added any more: evaluates the windows that are complete, in order.
  void advance(std::int64_t time_ms, Listener& listener);
  std::size_t size() const { return entries_.size(); }

 private:
  struct Entry {
    std::int64_t time_ms;
    Tuple tuple;
    bool seen;  ///< was in a window
  };
  void advance_by_count(std::int64_t time_ms, Listener& listener);
  void advance_by_time(std::int64_t time_ms, Listener& listener);
  /// After the window that ended at `end`: the next end worth a look.
  std::optional<std::int64_t> next_end(std::int64_t end, std::int64_t time_ms) const;
  std::int64_t end_after(std::int64_t time_ms) const;  ///< the first end that is later
  std::size_t first_not_before(std::int64_t time_ms) const;
  /// Evaluates entries [from, to) and lets go of those before. \return whether it was not refused.
  bool evaluate(std::size_t from, std::size_t to, std::int64_t end_ms, Listener& listener);
  void drop_first(std::size_t count, Listener& listener);

  const WindowExtent length_;
  const WindowExtent slide_;
  const std::int64_t origin_ms_;
  std::deque<Entry> entries_;  ///< by time, then arrival
  std::int64_t dropped_ = 0;   ///< entries that were before the first one
  std::int64_t next_count_;    ///< slide by count: a window ends after so many entries, dropped ones included
  std::optional<std::int64_t> next_end_;  ///< slide by time: the next end worth a look
  std::vector<Tuple> expired_;            ///< since the last window
  std::vector<Tuple> tuples_, added_;     ///< scratch
};

}  // namespace iotcloud::topology::internal
