#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/processes/outbox.h>
#include <iotcloud/processes/unix_socket.h>
#include <iotcloud/processes/vitals.h>

namespace iotcloud::processes {

/// How a watched process ended.
struct WatchedEnd {
  bool told = false;   ///< it was told to stop
  std::string killed;  ///< why its watch killed it; empty: it did not
  std::string how;     ///< ChildProcess::how_it_ended()
};

/// Talks to a process that runs code which is not ours, in frames (frames.h) on a Unix socket on which that process
/// listens, and watches it: one thread connects, sends, hears, pings, and notices its end. The watch kills a process
/// that is silent, spins, takes too much memory, does not stop in time, or says what is no frame. Thread safe.
class ProcessWatch {
 public:
  struct Options {
    std::string folder, socket;  ///< where the process listens, or will
    std::chrono::milliseconds ping_period{1000};
    std::chrono::milliseconds hang_limit{10000};  ///< a process that is silent for this long is killed
    /// A process that is told to stop ends itself within its limit; one that does not is killed so much later.
    std::chrono::milliseconds stop_margin{0};
    VitalLimits limits;
    std::string greeting;  ///< frames that are sent before all others, and to this process only
  };
  /// Functions that the watch calls, all on its thread. They may call the watch, but not destroy it. A config::Error of
  /// one of them ends the process.
  struct Events {
    std::function<void(const std::string& body)> on_frame;  ///< a frame of the process
    std::function<void()> on_ping;                      ///< once in a period: it sends what the process has to answer
    std::function<void(const WatchedEnd& end)> on_end;  ///< the last call
  };

  /// \param process the one that listens; it is killed if this throws. \throws std::system_error when this process
  /// lacks descriptors or threads
  ProcessWatch(Options options, ChildProcess process, Events events);
  /// When it has returned, no function runs or will run. The process goes on.
  ~ProcessWatch();
  ProcessWatch(const ProcessWatch&) = delete;
  ProcessWatch& operator=(const ProcessWatch&) = delete;

  int process() const { return process_.id(); }
  /// Sends a frame soon; drops it once the process was told to stop.
  void send(std::string frame);
  /// Tells the process to stop, by this frame, and kills it when `limit` and the margin have passed. The shortest of
  /// several limits holds.
  void stop(std::string frame, std::chrono::milliseconds limit);

  /// \name For the functions of Events only.
  /// @{
  /// \return whether the process dies of this: it was not killed before.
  bool kill(const std::string& why);
  std::uint64_t memory_bytes() const { return vitals_.memory_bytes(); }
  /// @}

 private:
  using Instant = std::chrono::steady_clock::time_point;

  void run() noexcept;
  bool connect();
  void converse();
  bool send_waiting();
  bool receive();
  void ping();
  bool overdue(std::chrono::nanoseconds silent);
  WatchedEnd wait_for_end();

  const Options options_;
  Waker waker_;
  const ChildProcess process_;
  const Events events_;
  std::atomic<bool> leaving_{false};

  config::Mutex mutex_;
  std::vector<std::string> waiting_ IOTCLOUD_GUARDED_BY(mutex_);      ///< frames to send
  std::optional<Instant> stop_deadline_ IOTCLOUD_GUARDED_BY(mutex_);  ///< nullopt: it was not told to stop

  // Used on the watch's thread only.
  OwnedDescriptor socket_;
  FrameReader frames_;
  Outbox outbox_;
  Instant next_ping_;
  bool asked_ = false;  ///< it has said nothing since the last ping; only the thread uses it
  std::string killed_;
  Vitals vitals_;

  std::jthread thread_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::processes
