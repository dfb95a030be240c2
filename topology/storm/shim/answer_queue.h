#pragma once

#include <deque>

#include <iotcloud/config/mutex.h>

namespace iotcloud::topology::storm {

class BoltHost;

/// The bolts of this process that have answers from other threads, each once. A thread of Java waits for them, and
/// calls BoltHost::take_answers() under the monitor that all calls into that bolt hold. Thread safe.
class AnswerQueue {
 public:
  void put(BoltHost& bolt) {
    {
      const config::MutexLock lock(mutex_);
      bolts_.push_back(&bolt);
    }
    filled_.notify_one();
  }
  BoltHost& wait() {
    const config::MutexLock lock(mutex_);
    filled_.wait(mutex_, [this]() IOTCLOUD_REQUIRES(mutex_) { return !bolts_.empty(); });
    BoltHost& bolt = *bolts_.front();
    bolts_.pop_front();
    return bolt;
  }

 private:
  config::Mutex mutex_;
  config::ConditionVariable filled_;
  std::deque<BoltHost*> bolts_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology::storm
