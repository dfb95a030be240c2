#include <memory>
#include <thread>
#include <utility>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/zookeeper/closing.h>

namespace iotcloud::discovery::zookeeper {
namespace {

constexpr std::chrono::seconds patience_at_exit{4};  // the library itself waits for at most 3 s

/// Counts the handles that are being closed.
class Count {
 public:
  void add(int change) {
    const config::MutexLock lock(mutex_);
    count_ += change;
    changed_.notify_all();
  }
  void wait_for_none(std::chrono::milliseconds patience) {
    const config::MutexLock lock(mutex_);
    changed_.wait_for(mutex_, patience, [this]() IOTCLOUD_REQUIRES(mutex_) { return count_ == 0; });
  }

 private:
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  int count_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
};

struct Closing {
  ~Closing() { count->wait_for_none(patience_at_exit); }
  /// The closing threads share it, because one may still run after this static object is destroyed.
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
    close = nullptr;  // destroys what the function owns before the waiting threads are told
    own->add(-1);
    all->add(-1);
  }).detach();
  own->wait_for_none(patience);
}

}  // namespace iotcloud::discovery::zookeeper
