#include <condition_variable>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>

#include <iotcloud/discovery/zookeeper/closing.h>

namespace iotcloud::discovery::zookeeper {
namespace {

constexpr std::chrono::seconds patience_at_exit{4};  // the library itself waits for 3 s at most

/// How many close now.
class Count {
 public:
  void add(int change) {
    const std::lock_guard lock(mutex_);
    count_ += change;
    changed_.notify_all();
  }
  void wait_for_none(std::chrono::milliseconds patience) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, patience, [this] { return count_ == 0; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  int count_ = 0;  ///< guarded by mutex_
};

struct Closing {
  ~Closing() { count->wait_for_none(patience_at_exit); }
  /// Shared with the threads: one may outlast the process's last objects.
  const std::shared_ptr<Count> count = std::make_shared<Count>();
};

}  // namespace

void close_elsewhere(std::function<void()> close, std::chrono::milliseconds patience) {
  static Closing closing;
  const auto own = std::make_shared<Count>();
  const auto all = closing.count;
  own->add(1);
  all->add(1);
  std::thread([close = std::move(close), own, all]() mutable {
    close();
    close = nullptr;  // what it owns goes before anybody is told
    own->add(-1);
    all->add(-1);
  }).detach();
  own->wait_for_none(patience);
}

}  // namespace iotcloud::discovery::zookeeper
