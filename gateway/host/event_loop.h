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
  /// Stops; what is still queued is destroyed unrun.
  ~EventLoop();
  EventLoop(const EventLoop&) = delete;
  EventLoop& operator=(const EventLoop&) = delete;

  void post(std::function<void()> callback);
  /// An id for start_timer or watch_descriptor, for callbacks that must know their own.
  HandlerId new_handler();
  /// First call after `first`, then each `period` (0: once). From intended times: a late call does not shift later
  /// ones; what was missed is caught up, unless it is more than a second (and a period) behind: that is skipped.
  HandlerId start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                        std::function<void()> callback, HandlerId id = 0);
  /// Calls while the descriptor is readable (or writable). It stays the caller's and may be watched several times.
  /// A descriptor that cannot be watched is logged; its callback never runs.
  HandlerId watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback, HandlerId id = 0);
  /// After this returns on the loop's thread the handler does not run any more; elsewhere: soon.
  void stop_handler(HandlerId id);

  /// Runs nothing any more. Waits for the callback that runs, unless called from it. What is posted later is kept
  /// until the loop dies, unrun.
  void stop();
  bool on_this_thread() const;
  /// How long the loop has not come round: 0 when it answers. A loop that sleeps answers; one stuck in a callback does
  /// not. Each call also sends the next probe, so call it regularly.
  std::chrono::milliseconds stalled();
  /// On the loop's thread: for whom its callback works while the object lives, so that others can name one who is
  /// stuck.
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
  /// Whom the callback that runs now serves; 0: nobody, or nobody said.
  std::uint64_t serving() const;
  /// Gives a stuck thread up: it is detached and its memory stays. For the end of a process only.
  void abandon();

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

}  // namespace iotcloud::gateway
