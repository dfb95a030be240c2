#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

namespace iotcloud::discovery {

/// Runs tasks one at a time on its own thread: in the order posted, later ones when their time has come.
/// Thread safe. A task that throws is logged. Tasks that have not run when it stops are dropped.
class SerialThread {
 public:
  using Task = std::function<void()>;
  using Instant = std::chrono::steady_clock::time_point;

  explicit SerialThread(std::string name);
  ~SerialThread() { stop(); }
  SerialThread(const SerialThread&) = delete;
  SerialThread& operator=(const SerialThread&) = delete;

  void post(Task task) { post_at(Instant::min(), std::move(task)); }
  void post_at(Instant when, Task task);
  /// Returns when the task that runs is done; later posts are ignored. Not from its own thread.
  void stop();
  bool is_current() const { return std::this_thread::get_id() == thread_.get_id(); }

 private:
  void run();

  const std::string name_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stopping_ = false;                                    ///< guarded by mutex_
  std::uint64_t posted_ = 0;                                 ///< guarded by mutex_
  std::map<std::pair<Instant, std::uint64_t>, Task> tasks_;  ///< by time, then order; guarded by mutex_
  std::thread thread_;
};

}  // namespace iotcloud::discovery
