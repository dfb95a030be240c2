#include <exception>

#include <pthread.h>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/client/serial_thread.h>

namespace iotcloud::discovery {
namespace {
const config::Logger log{"discovery"};
}

SerialThread::SerialThread(std::string name) : name_(std::move(name)), thread_([this] { run(); }) {}

void SerialThread::post_at(Instant when, Task task) {
  const std::lock_guard lock(mutex_);
  if (stopping_) return;
  const auto place = tasks_.emplace(std::make_pair(when, posted_++), std::move(task)).first;
  if (place == tasks_.begin()) wake_.notify_one();
}

void SerialThread::stop() {
  std::map<std::pair<Instant, std::uint64_t>, Task> dropped;  // dies outside the lock: what tasks own may be large
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    dropped.swap(tasks_);
    wake_.notify_one();
  }
  if (thread_.joinable()) thread_.join();
}

void SerialThread::run() {
  ::pthread_setname_np(::pthread_self(), name_.substr(0, 15).c_str());
  std::unique_lock lock(mutex_);
  while (!stopping_) {
    if (tasks_.empty()) {
      wake_.wait(lock);
      continue;
    }
    const Instant due = tasks_.begin()->first.first;
    if (due > std::chrono::steady_clock::now()) {
      wake_.wait_until(lock, due);
      continue;
    }
    Task task = std::move(tasks_.begin()->second);
    tasks_.erase(tasks_.begin());
    lock.unlock();
    try {
      task();
    } catch (const std::exception& error) {
      log.error("{}: a callback threw: {}", name_, error.what());
    } catch (...) {
      log.error("{}: a callback threw something that is no std::exception", name_);
    }
    task = nullptr;  // what it owns dies here, not under the lock
    lock.lock();
  }
}

}  // namespace iotcloud::discovery
