#pragma once

#include <chrono>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

namespace iotcloud::brokers::spool {

/// What the spools' thread works for.
class Served {
 public:
  using Time = std::chrono::system_clock::time_point;
  virtual ~Served() = default;
  /// Does what is to be done. Called on the spools' thread. \return when it wants to be called again if nobody wakes it
  virtual std::optional<Time> serve() noexcept = 0;
};

/// One thread for all spools of the process: it hands on what waits on disk, puts files on the disk and removes them.
/// It ends with the last of its users. Thread safe.
class SpoolThread {
 public:
  static std::shared_ptr<SpoolThread> of_process();
  SpoolThread();
  ~SpoolThread();
  SpoolThread(const SpoolThread&) = delete;
  SpoolThread& operator=(const SpoolThread&) = delete;

  void join(Served& served);
  /// Returns when serve() does not run and never will again; from inside serve() at once.
  void leave(Served& served);
  /// Calls serve() soon.
  void wake(Served& served);

 private:
  struct State {
    std::mutex mutex;
    std::condition_variable changed;
    std::map<Served*, Served::Time> due;  ///< guarded by mutex
    Served* serving = nullptr;            ///< guarded by mutex
    bool stopping = false;                ///< guarded by mutex
  };
  static void run(const std::shared_ptr<State>& state);

  const std::shared_ptr<State> state_ = std::make_shared<State>();
  std::thread thread_;
};

}  // namespace iotcloud::brokers::spool
