#pragma once

#include <cstddef>
#include <deque>
#include <functional>
#include <future>
#include <memory>
#include <thread>
#include <vector>

#include <iotcloud/config/mutex.h>

namespace iotcloud::master {

/// A few threads that ask gateways on behalf of all callers, so that a question to a thousand gateways, or a thousand
/// such questions, start no thread for each. Questions wait in the order in which they came. Thread safe.
class GatewayAsks {
 public:
  /// \param threads most questions at once; each thread is started when it is first needed
  explicit GatewayAsks(std::size_t threads = 16) : most_(threads) {}
  /// Waits for the questions under way; those that wait are not asked, and their futures have a broken promise.
  ~GatewayAsks();
  GatewayAsks(const GatewayAsks&) = delete;
  GatewayAsks& operator=(const GatewayAsks&) = delete;

  /// \param question runs on one of the threads
  template <typename Question>
  auto ask(Question&& question) {
    using Answer = std::invoke_result_t<Question>;
    auto task = std::make_shared<std::packaged_task<Answer()>>(std::forward<Question>(question));
    auto answer = task->get_future();
    put([task = std::move(task)] { (*task)(); });
    return answer;
  }
  /// How many threads were started.
  std::size_t threads() const IOTCLOUD_EXCLUDES(mutex_);

 private:
  void put(std::function<void()> task) IOTCLOUD_EXCLUDES(mutex_);
  void work() IOTCLOUD_EXCLUDES(mutex_);

  const std::size_t most_;
  mutable config::Mutex mutex_;
  config::ConditionVariable changed_;
  bool ending_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::size_t idle_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< threads that wait for a task
  std::deque<std::function<void()>> tasks_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<std::jthread> threads_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::master
