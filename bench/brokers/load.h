#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>

#include <iotcloud/bench/brokers/options.h>
#include <iotcloud/bench/harness/latency_histogram.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {

/// The first bytes of each body.
struct Stamp {
  std::uint32_t run;  ///< a leftover message of another run is not counted
  std::uint32_t driver;
  std::uint64_t number;  ///< 0, 1, 2, ... for each driver
  std::int64_t intended_ns;
};

/// Decides what is sent and when, and checks what comes back: the same for all clients. Thread safe, except for the
/// schedule.
class Load {
 public:
  static constexpr std::int64_t never = INT64_MAX;

  explicit Load(const BrokerOptions& options);

  /// Starts the schedule now.
  void begin();
  /// Ends sending.
  void stop() { stopped_ = true; }
  bool stopped() const { return stopped_; }

  /// The schedule, for one thread: when the next message is due (now_ns(); 0: at once; never: an arrival triggers it),
  /// and its driver, which take_due() returns.
  std::int64_t due_ns() const;
  unsigned take_due();

  /// Calls `send_it(driver)` each time a message is due, until none will be. For one thread.
  template <typename Send>
  void send_on_schedule(Send&& send_it) {
    for (std::int64_t due = due_ns(); due != never; due = due_ns()) {
      if (due > now_ns()) sleep_until(due);
      send_it(take_due());
    }
  }

  /// Calls `send_it(stamp)` for the driver's next message, one call at a time for each driver.
  template <typename Send>
  void send(unsigned driver, Send&& send_it) {
    Driver& one = drivers_[driver];
    const std::lock_guard lock(one.sending);
    const Stamp stamp{run_, driver, one.sent++, intended_ns(driver, one.sent - 1)};
    sent_.fetch_add(1, std::memory_order_relaxed);
    send_it(stamp);
  }

  /// Counts a body that came back. \return the driver that must send its next message at once (closed loop).
  std::optional<unsigned> arrived(std::span<const std::byte> body);

  /// Messages that are due between these two calls are timed when they come back, however late.
  void begin_recording();
  void end_recording();

  std::uint64_t sent() const { return sent_; }
  std::uint64_t came_back() const { return arrived_; }
  std::uint64_t wrong() const { return wrong_; }  ///< out of order, twice or of another size
  LatencyHistogram::Summary latency() const { return latency_.summary(); }

 private:
  struct Driver {
    std::mutex sending;
    std::uint64_t sent = 0;                   ///< guarded by `sending`
    std::atomic<std::uint64_t> expected = 0;  ///< number of the next message to come back
  };

  std::int64_t intended_ns(unsigned driver, std::uint64_t number) const;

  const std::uint32_t run_;
  const std::size_t size_;
  const unsigned driver_count_;
  const double step_ns_;  ///< between two messages of the schedule; 0: a closed loop
  const std::uint64_t loop_;
  const std::unique_ptr<Driver[]> drivers_;
  std::int64_t began_ns_ = 0;
  std::uint64_t taken_ = 0;
  LatencyHistogram latency_;
  std::atomic<bool> stopped_ = false;
  std::atomic<std::int64_t> record_from_ns_ = never, record_until_ns_ = never;  ///< intended times
  std::atomic<std::uint64_t> sent_ = 0, arrived_ = 0, wrong_ = 0;
};

}  // namespace iotcloud::bench
