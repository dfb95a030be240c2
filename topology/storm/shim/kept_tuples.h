#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/tasks/conflater.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology::storm {

/// The tuples that wait for a bolt of which some inputs have keep_last. Storm's executor puts them in, another thread
/// runs the bolt. Thread safe.
class KeptTuples {
 public:
  /// So many tuples of inputs without keep_last may wait.
  static constexpr std::size_t capacity = 1024;

  /// \param inputs those that have keep_last; their streams live as long.
  explicit KeptTuples(std::vector<internal::KeepLast> inputs) : waiting_(std::move(inputs)) {}
  ~KeptTuples() { end(); }
  KeptTuples(const KeptTuples&) = delete;
  KeptTuples& operator=(const KeptTuples&) = delete;

  /// Adds a tuple. One of an input without keep_last waits for room. \return the tuple that it replaces, or none
  Tuple put(const Tuple& tuple);
  /// Makes next() return a tick before the next tuple.
  void request_tick();
  /// Makes next() return, with a tuple if one waits: the bolt's thread shall write its answers.
  void wake();

  /// What the bolt's thread does next, in this order.
  struct Next {
    bool tick = false;
    Tuple tuple;  ///< or none
    bool end = false;
  };
  /// Waits for something to do.
  Next next();
  /// Lets the tuples that wait go; next() returns `end` from now on, and put() keeps nothing.
  void end();

 private:
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  internal::Conflater waiting_ IOTCLOUD_GUARDED_BY(mutex_);  ///< has one handle of each of its tuples
  std::size_t unlimited_ IOTCLOUD_GUARDED_BY(mutex_) = 0;    ///< tuples in it of inputs without keep_last
  bool tick_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool woken_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool ended_ IOTCLOUD_GUARDED_BY(mutex_) = false;
};

}  // namespace iotcloud::topology::storm
