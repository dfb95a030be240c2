#include <utility>

#include <iotcloud/master/api/gateway_asks.h>

namespace iotcloud::master {

GatewayAsks::~GatewayAsks() {
  std::deque<std::function<void()>> dropped;
  std::vector<std::jthread> ending;
  {
    const config::MutexLock lock(mutex_);
    ending_ = true;
    dropped.swap(tasks_);
    ending.swap(threads_);
  }
  changed_.notify_all();
}

void GatewayAsks::put(std::function<void()> task) {
  const config::MutexLock lock(mutex_);
  tasks_.push_back(std::move(task));
  if (idle_ < tasks_.size() && threads_.size() < most_) {
    threads_.emplace_back([this] { work(); });
  } else {
    changed_.notify_one();
  }
}

void GatewayAsks::work() {
  while (true) {
    std::function<void()> task;
    {
      const config::MutexLock lock(mutex_);
      ++idle_;
      while (!ending_ && tasks_.empty()) changed_.wait(mutex_);
      --idle_;
      if (ending_) return;
      task = std::move(tasks_.front());
      tasks_.pop_front();
    }
    task();
  }
}

std::size_t GatewayAsks::threads() const {
  const config::MutexLock lock(mutex_);
  return threads_.size();
}

}  // namespace iotcloud::master
