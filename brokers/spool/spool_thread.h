#pragma once

#include <map>
#include <memory>
#include <optional>
#include <thread>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::spool {

/// A spool that the spools' thread serves.
class ServedSpool {
 public:
  /// By the spool's clock, whose changes of the time of day neither delay nor hurry the work.
  using Time = config::Clock::Instant;
  virtual ~ServedSpool() = default;
  /// Does the work that is due; the spools' thread calls it. \return when to call it again if no wake() comes before.
  virtual std::optional<Time> serve() noexcept = 0;
};

/// The one thread that serves all spools of the process that go by the same clock: it sends messages that wait on disk,
/// and syncs and removes files. It ends with the last object that holds it. Thread safe.
class SpoolThread {
 public:
  static std::shared_ptr<SpoolThread> of_process(const config::Clock& clock);
  /// \param clock outlives all spools that were added
  explicit SpoolThread(const config::Clock& clock);
  ~SpoolThread();
  SpoolThread(const SpoolThread&) = delete;
  SpoolThread& operator=(const SpoolThread&) = delete;

  void add(ServedSpool& served);
  /// Returns when serve() does not run and will not run again. Called from serve(), it returns at once.
  void remove(ServedSpool& served);
  /// Has serve() called soon.
  void wake(ServedSpool& served);

 private:
  struct State {
    explicit State(const config::Clock& time) : clock(time) {}
    const config::Clock& clock;
    config::Mutex mutex;
    config::ConditionVariable changed;
    std::map<ServedSpool*, ServedSpool::Time> due IOTCLOUD_GUARDED_BY(mutex);
    ServedSpool* serving IOTCLOUD_GUARDED_BY(mutex) = nullptr;
    bool stopping IOTCLOUD_GUARDED_BY(mutex) = false;
  };
  static void run(State& state);

  const std::shared_ptr<State> state_;
  std::thread thread_;
};

}  // namespace iotcloud::brokers::spool
