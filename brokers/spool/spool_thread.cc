#include "iotcloud/brokers/spool/spool_thread.h"

#include <algorithm>

#include <pthread.h>

namespace iotcloud::brokers::spool {
namespace {

using Time = Served::Time;

}  // namespace

std::shared_ptr<SpoolThread> SpoolThread::of_process() {
  static std::mutex mutex;
  static std::weak_ptr<SpoolThread> shared;
  const std::lock_guard lock(mutex);
  auto thread = shared.lock();
  if (!thread) shared = thread = std::make_shared<SpoolThread>();
  return thread;
}

SpoolThread::SpoolThread() {
  thread_ = std::thread([state = state_] { run(state); });
  pthread_setname_np(thread_.native_handle(), "spool");
}

SpoolThread::~SpoolThread() {
  {
    const std::lock_guard lock(state_->mutex);
    state_->stopping = true;
  }
  state_->changed.notify_all();
  if (thread_.get_id() == std::this_thread::get_id()) {
    thread_.detach();  // the last publisher was closed by one of its own callbacks
  } else {
    thread_.join();
  }
}

void SpoolThread::join(Served& served) {
  const std::lock_guard lock(state_->mutex);
  state_->due[&served] = Time::max();
}

void SpoolThread::leave(Served& served) {
  std::unique_lock lock(state_->mutex);
  state_->due.erase(&served);
  if (thread_.get_id() == std::this_thread::get_id()) return;
  state_->changed.wait(lock, [&] { return state_->serving != &served; });
}

void SpoolThread::wake(Served& served) {
  {
    const Time now = std::chrono::system_clock::now();
    const std::lock_guard lock(state_->mutex);
    const auto found = state_->due.find(&served);
    if (found == state_->due.end() || found->second <= now) return;
    found->second = now;
  }
  state_->changed.notify_all();
}

void SpoolThread::run(const std::shared_ptr<State>& state) {
  std::unique_lock lock(state->mutex);
  while (!state->stopping) {
    const auto next = std::min_element(state->due.begin(), state->due.end(),
                                       [](const auto& a, const auto& b) { return a.second < b.second; });
    if (next == state->due.end() || next->second == Time::max()) {
      state->changed.wait(lock);
      continue;
    }
    if (next->second > std::chrono::system_clock::now()) {
      state->changed.wait_until(lock, Time(next->second));
      continue;
    }
    Served* const served = next->first;
    next->second = Time::max();  // whoever wakes it from now on is heard
    state->serving = served;
    lock.unlock();
    const std::optional<Time> again = served->serve();
    lock.lock();
    state->serving = nullptr;
    const auto found = state->due.find(served);
    if (found != state->due.end() && again) found->second = std::min(found->second, *again);
    state->changed.notify_all();
  }
}

}  // namespace iotcloud::brokers::spool
