#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <thread>
#include <utility>

#include <iotcloud/config/mutex.h>

namespace iotcloud::discovery {

/// Runs tasks one at a time on its own thread: in the order of posting, scheduled tasks when their time has come.
/// Thread safe. A task that throws is logged. When it stops, it drops the tasks that have not run.
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
  /// Returns when the current task is done; ignores later posts. Do not call it on its own thread.
  void stop();

 private:
  void run();

  const std::string name_;
  config::Mutex mutex_;
  config::ConditionVariable wake_;
  bool stopping_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::uint64_t posted_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  /// by time, then in the order of posting
  std::map<std::pair<Instant, std::uint64_t>, Task> tasks_ IOTCLOUD_GUARDED_BY(mutex_);
  std::thread thread_;
};

}  // namespace iotcloud::discovery
