#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>

#include <iotcloud/bench/brokers/options.h>
#include <iotcloud/bench/harness/latency_histogram.h>

namespace iotcloud::bench {

/// The first bytes of each body.
struct Stamp {
  std::uint32_t run;  ///< a message left over by another run is not counted
  std::uint32_t driver;
  std::uint64_t number;  ///< 0, 1, 2, ... for each driver
  std::int64_t intended_ns;
};

/// What is sent and when, and what came back: the same for all clients. Thread safe, but for the schedule.
class Load {
 public:
  static constexpr std::int64_t never = INT64_MAX;

  explicit Load(const BrokerOptions& options);

  /// The schedule starts now.
  void begin();
  /// Nothing more is sent.
  void stop() { stopped_ = true; }
  bool stopped() const { return stopped_; }

  /// The schedule, for one thread: when the next message is due (now_ns(); 0: at once; never: an arrival brings it),
  /// and taking it: its driver.
  std::int64_t due_ns() const;
  unsigned take_due();

  /// Calls `send_it(stamp)` for the driver's next message, one call at a time for each driver.
  template <typename Send>
  void send(unsigned driver, Send&& send_it) {
    Driver& one = drivers_[driver];
    const std::lock_guard lock(one.sending);
    const Stamp stamp{run_, driver, one.sent++, intended_ns(driver, one.sent - 1)};
    sent_.fetch_add(1, std::memory_order_relaxed);
    send_it(stamp);
  }

  /// A body came back. \return the driver that is to send its next one at once (closed loop).
  std::optional<unsigned> arrived(std::span<const std::byte> body);

  /// What is to be sent from now on is timed when it comes back, however late, until end_recording(): that is what is
  /// to be sent after it.
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
    std::atomic<std::uint64_t> expected = 0;  ///< the number that comes back next
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
