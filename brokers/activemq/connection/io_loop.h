#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/wake_event.h"
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::activemq {

/// Two threads for the connections of a broker object. One waits for the sockets, serves the connections and runs the
/// handlers of what came, so that a message is handed to no other thread. The other one stands by: when the first has
/// been in handlers for a while it goes on with the sockets, and the first one keeps to the handlers until it has
/// nothing to do; then that one stands by.
class IoLoop {
 public:
  using Instant = config::Clock::Instant;

  /// What it serves. Thread safe.
  class Service {
   public:
    virtual ~Service() = default;
    struct Wish {
      int socket = -1;  ///< none
      bool write = false;
      Instant at = Instant::max();  ///< to be served then at the latest
    };
    virtual Wish wish() = 0;
    /// There may be something to do. Never waits for the server.
    virtual void serve(bool readable, bool writable) = 0;
    virtual bool has_handlers_to_run() { return false; }
    /// Runs handlers of what has come: a few while this thread is the one that serves, otherwise all.
    virtual void run_handlers() {}
    /// Sends what was left to be sent together.
    virtual void flush() = 0;
  };

  explicit IoLoop(const config::Clock& clock) : clock_(clock) {}
  ~IoLoop() { stop(); }
  IoLoop(const IoLoop&) = delete;
  IoLoop& operator=(const IoLoop&) = delete;

  /// Begins to serve these; they live until stop(). Further calls do nothing. Thread safe.
  void start(std::vector<Service*> services);
  /// Ends the threads, when their handlers have ended. Not from them.
  void stop();

  /// Something has changed: all are asked for their wishes soon. Thread safe.
  void wake();
  /// Whether this thread is the one that serves now; it needs no waking.
  bool serves() const { return server_ == std::this_thread::get_id(); }

  /// Says that what this thread's handlers send may wait for flush().
  void gather(bool on);
  bool gathers() const;
  void flush();

 private:
  void begin_thread();
  void run();
  void stand_by(std::unique_lock<std::mutex>& lock);
  void round();
  void run_handlers();
  int wait_ms(Instant until) const;

  const config::Clock& clock_;
  client::WakeEvent event_;
  std::atomic<std::thread::id> server_;   ///< the thread that serves; none: whoever comes first
  std::atomic<std::thread::id> handler_;  ///< the thread that serves, while it runs handlers
  std::atomic<std::uint64_t> rounds_ = 0;
  std::atomic<std::uint64_t> batches_ = 0;  ///< rounds in which handlers ran
  std::atomic<bool> watched_ = false;       ///< the thread that stands by looks now and then
  std::atomic<bool> ending_ = false;

  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::thread> threads_;  ///< guarded by mutex_
  std::vector<Service*> services_;    ///< set before the threads begin
};

}  // namespace iotcloud::brokers::activemq
