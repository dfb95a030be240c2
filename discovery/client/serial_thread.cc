#include <exception>

#include <pthread.h>

#include <iotcloud/discovery/client/serial_thread.h>
#include <iotcloud/discovery/logger.h>

namespace iotcloud::discovery {
namespace {}

SerialThread::SerialThread(std::string name) : name_(std::move(name)), thread_([this] { run(); }) {}

void SerialThread::post_at(Instant when, Task task) {
  const config::MutexLock lock(mutex_);
  if (stopping_) return;
  const auto place = tasks_.emplace(std::make_pair(when, posted_++), std::move(task)).first;
  if (place == tasks_.begin()) wake_.notify_one();
}

void SerialThread::stop() {
  std::map<std::pair<Instant, std::uint64_t>, Task> dropped;  // destroyed outside the lock, because tasks may own a lot
  {
    const config::MutexLock lock(mutex_);
    stopping_ = true;
    dropped.swap(tasks_);
    wake_.notify_one();
  }
  if (thread_.joinable()) thread_.join();
}

void SerialThread::run() {
  ::pthread_setname_np(::pthread_self(), name_.substr(0, 15).c_str());
  config::UniqueLock lock(mutex_);
  while (!stopping_) {
    if (tasks_.empty()) {
      wake_.wait(mutex_);
      continue;
    }
    const Instant due = tasks_.begin()->first.first;
    if (due > std::chrono::steady_clock::now()) {
      wake_.wait_until(mutex_, due);
      continue;
    }
    Task task = std::move(tasks_.begin()->second);
    tasks_.erase(tasks_.begin());
    lock.unlock();
    try {
      task();
    } catch (const std::exception& error) {
      logger.error("{}: a callback threw: {}", name_, error.what());
    } catch (...) {
      logger.error("{}: a callback threw something that is no std::exception", name_);
    }
    task = nullptr;  // destroys what the task owns here, not under the lock
    lock.lock();
  }
}

}  // namespace iotcloud::discovery
