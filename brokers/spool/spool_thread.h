#pragma once

#include <map>
#include <memory>
#include <optional>
#include <thread>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::spool {

/// A spool that the spools' thread serves.
class Served {
 public:
  /// The steady clock's time, so that a change of the wall clock neither delays nor hurries the work.
  using Time = config::Clock::Instant;
  virtual ~Served() = default;
  /// Does the work that is due; the spools' thread calls it. \return when to call it again if no wake() comes before.
  virtual std::optional<Time> serve() noexcept = 0;
};

/// The one thread that serves all spools of the process: it sends messages that wait on disk, and syncs and removes
/// files. It ends with the last object that holds it. Thread safe.
class SpoolThread {
 public:
  static std::shared_ptr<SpoolThread> of_process();
  SpoolThread();
  ~SpoolThread();
  SpoolThread(const SpoolThread&) = delete;
  SpoolThread& operator=(const SpoolThread&) = delete;

  void add(Served& served);
  /// Returns when serve() does not run and will not run again. Called from serve(), it returns at once.
  void remove(Served& served);
  /// Has serve() called soon.
  void wake(Served& served);

 private:
  struct State {
    config::Mutex mutex;
    config::ConditionVariable changed;
    std::map<Served*, Served::Time> due IOTCLOUD_GUARDED_BY(mutex);
    Served* serving IOTCLOUD_GUARDED_BY(mutex) = nullptr;
    bool stopping IOTCLOUD_GUARDED_BY(mutex) = false;
  };
  static void run(State& state);

  const std::shared_ptr<State> state_ = std::make_shared<State>();
  std::thread thread_;
};

}  // namespace iotcloud::brokers::spool
