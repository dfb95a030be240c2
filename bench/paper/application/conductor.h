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

/// Reads orders from the file `order` of a folder, gives each to all drivers of this process, and writes the result to
/// PROCESS_ID.json there when all messages came back, or the order's patience is over. Has one thread, which sleeps
/// during the measurement. Thread safe.
class Conductor {
 public:
  using Begin = std::function<void(std::shared_ptr<Point>)>;

  /// This process's conductor of the folder; lives as long as somebody holds it.
  static std::shared_ptr<Conductor> of(const std::string& folder);
  explicit Conductor(std::string folder);
  ~Conductor();
  Conductor(const Conductor&) = delete;
  Conductor& operator=(const Conductor&) = delete;

  /// Adds a driver, which takes part from the next order on. The conductor's thread calls `begin`, which must only pass
  /// the order on.
  /// \return the driver's number in this process: 0, 1, 2, ...
  unsigned join(Begin begin);
  /// Removes a driver. When this returns, `begin` does not run any more.
  void leave(unsigned number);

 private:
  void run(const std::stop_token& stop);
  void carry_out(const Order& order, const std::stop_token& stop);
  bool wait_until(std::int64_t when_ns, const std::stop_token& stop);
  void write(const Point& point) const;

  const std::string folder_;
  std::mutex mutex_;
  std::map<unsigned, Begin> drivers_;  ///< guarded by mutex_
  unsigned joined_ = 0;                ///< guarded by mutex_; includes those that left
  std::jthread thread_;
};

}  // namespace iotcloud::bench::paper
