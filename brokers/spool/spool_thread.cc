#include "iotcloud/brokers/spool/spool_thread.h"

#include <algorithm>

#include <pthread.h>

namespace iotcloud::brokers::spool {
namespace {

using Time = ServedSpool::Time;

}  // namespace

std::shared_ptr<SpoolThread> SpoolThread::of_process(const config::Clock& clock) {
  static config::Mutex mutex;
  static std::map<const config::Clock*, std::weak_ptr<SpoolThread>> threads;
  const config::MutexLock lock(mutex);
  std::erase_if(threads, [](const auto& entry) { return entry.second.expired(); });
  auto thread = threads[&clock].lock();
  if (!thread) threads[&clock] = thread = std::make_shared<SpoolThread>(clock);
  return thread;
}

SpoolThread::SpoolThread(const config::Clock& clock) : state_(std::make_shared<State>(clock)) {
  thread_ = std::thread([state = state_] { run(*state); });
  pthread_setname_np(thread_.native_handle(), "spool");
}

SpoolThread::~SpoolThread() {
  {
    const config::MutexLock lock(state_->mutex);
    state_->stopping = true;
  }
  state_->changed.notify_all();
  if (thread_.get_id() == std::this_thread::get_id()) {
    thread_.detach();  // a callback on this thread closed the last publisher, and a thread cannot join itself
  } else {
    thread_.join();
  }
}

void SpoolThread::add(ServedSpool& served) {
  const config::MutexLock lock(state_->mutex);
  state_->due[&served] = Time::max();
}

void SpoolThread::remove(ServedSpool& served) {
  State& state = *state_;
  const config::MutexLock lock(state.mutex);
  state.due.erase(&served);
  if (thread_.get_id() == std::this_thread::get_id()) return;
  state.changed.wait(state.mutex, [&]() IOTCLOUD_REQUIRES(state.mutex) { return state.serving != &served; });
}

void SpoolThread::wake(ServedSpool& served) {
  {
    const Time now = state_->clock.now();
    const config::MutexLock lock(state_->mutex);
    const auto found = state_->due.find(&served);
    if (found == state_->due.end() || found->second <= now) return;
    found->second = now;
  }
  state_->changed.notify_all();
}

void SpoolThread::run(State& state) {
  config::UniqueLock lock(state.mutex);
  while (!state.stopping) {
    const auto next = std::min_element(state.due.begin(), state.due.end(),
                                       [](const auto& a, const auto& b) { return a.second < b.second; });
    if (next == state.due.end() || next->second == Time::max()) {
      state.changed.wait(state.mutex);
      continue;
    }
    if (next->second > state.clock.now()) {
      state.changed.wait_until(state.mutex, state.clock, Time(next->second));
      continue;
    }
    ServedSpool* const served = next->first;
    next->second = Time::max();  // set before serve(), so that a wake() during it is not lost
    state.serving = served;
    lock.unlock();
    const std::optional<Time> again = served->serve();
    lock.lock();
    state.serving = nullptr;
    const auto found = state.due.find(served);
    if (found != state.due.end() && again) found->second = std::min(found->second, *again);
    state.changed.notify_all();
  }
}

}  // namespace iotcloud::brokers::spool
