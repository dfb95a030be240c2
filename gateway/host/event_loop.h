#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::gateway {

using drivers::HandlerId;

/// One thread that runs timers, descriptors and posted calls, one at a time. Sleeps when there is nothing to do. All
/// members are thread safe; callbacks run on the loop's thread. A callback that throws is logged, the loop goes on.
class EventLoop {
 public:
  /// \param name of the thread, as `top -H` shows it (cut to 15 characters).
  explicit EventLoop(const std::string& name);
  /// Stops the loop; queued calls are destroyed without being run.
  ~EventLoop();
  EventLoop(const EventLoop&) = delete;
  EventLoop& operator=(const EventLoop&) = delete;

  void post(std::function<void()> callback);
  /// An id to pass to start_timer() or watch_descriptor(), for a callback that must know its own id.
  HandlerId new_handler();
  /// Calls after `first`, then every `period` (0: only once). Times count from the intended start, so a late call does
  /// not shift later ones. Missed calls are made up for, except those that are late by more than a second and by more
  /// than a period: they are skipped.
  HandlerId start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                        std::function<void()> callback, HandlerId id = 0);
  /// Calls the callback while the descriptor is readable (or writable). The caller keeps owning the descriptor, and may
  /// have it watched several times. If the descriptor cannot be watched, the loop logs that and never runs the
  /// callback.
  HandlerId watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback, HandlerId id = 0);
  /// Ends a timer or a watch. Called on the loop's thread, it takes effect before it returns; on other threads, soon
  /// after.
  void stop_handler(HandlerId id);

  /// Stops the loop for good. Waits for the running callback, unless called from it. Calls posted later are never run,
  /// and are destroyed with the loop.
  void stop();
  bool on_this_thread() const;
  /// How long the loop has been in one callback, as far as calls of this function have seen; 0 if it has answered the
  /// last probe, or a callback has ended since the last call: a loop that is only busy is not stuck. Each call also
  /// posts the next probe, so call it regularly.
  std::chrono::milliseconds stalled();
  /// While such an object lives on the loop's thread, serving() returns `whom`, so that other threads can tell whose
  /// callback is stuck.
  class Serving {
   public:
    Serving(EventLoop& loop, std::uint64_t whom);
    ~Serving();
    Serving(const Serving&) = delete;
    Serving& operator=(const Serving&) = delete;

   private:
    EventLoop& loop_;
    const std::uint64_t before_;
  };
  /// The number given to the running callback's Serving object; 0: no callback runs, or it has none.
  std::uint64_t serving() const;
  /// Detaches a stuck thread and leaks its memory. Only for a process that is about to end.
  void abandon();

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
