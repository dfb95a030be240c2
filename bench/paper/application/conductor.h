#pragma once

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include <iotcloud/bench/paper/application/order.h>
#include <iotcloud/bench/paper/application/point.h>

namespace iotcloud::bench::paper {

/// Reads orders from the file `order` of a folder, hands each to all drivers of this process, and writes what became of
/// it to PROCESS_ID.json there when everything came back, or the order's patience is over. One thread, which sleeps
/// while it is measured. Thread safe.
class Conductor {
 public:
  using Begin = std::function<void(std::shared_ptr<Point>)>;

  /// The one of this folder in this process; lives as long as somebody has it.
  static std::shared_ptr<Conductor> of(const std::string& folder);
  explicit Conductor(std::string folder);
  ~Conductor();
  Conductor(const Conductor&) = delete;
  Conductor& operator=(const Conductor&) = delete;

  /// A driver takes part from the next order on; `begin` is called on the conductor's thread and only hands it on.
  /// \return the driver's number in this process: 0, 1, 2, ...
  unsigned join(Begin begin);
  /// When this returns its `begin` does not run and never will again.
  void leave(unsigned number);

 private:
  void run(const std::stop_token& stop);
  void carry_out(const Order& order, const std::stop_token& stop);
  bool wait_until(std::int64_t when_ns, const std::stop_token& stop);
  void write(const Point& point) const;

  const std::string folder_;
  std::mutex mutex_;
  std::map<unsigned, Begin> drivers_;  ///< guarded by mutex_
  unsigned joined_ = 0;                ///< likewise; those that left count too
  std::jthread thread_;
};

}  // namespace iotcloud::bench::paper
