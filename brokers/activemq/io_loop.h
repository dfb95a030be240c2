#pragma once

#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/wake_event.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::activemq {

/// Two threads for the connections of a broker object. The serving thread waits for the sockets, serves the connections
/// and runs the handlers of arrived messages, so that no message passes to another thread. The other thread stands by.
/// When the serving thread has been in handlers for a while, the other one takes over the sockets; the first runs
/// handlers until none is left and then stands by itself.
class IoLoop {
 public:
  using Instant = config::Clock::Instant;

  /// A connection that the loop serves. Thread safe.
  class Service {
   public:
    virtual ~Service() = default;
    struct Wish {
      int socket = -1;  ///< -1: none
      bool write = false;
      Instant at = Instant::max();  ///< the latest time at which to call serve()
    };
    virtual Wish wish() = 0;
    /// Called when there may be work. Never waits for the server.
    virtual void serve(bool readable, bool writable) = 0;
    virtual bool has_handlers_to_run() { return false; }
    /// Runs the handlers of arrived messages: a few on the serving thread, all on the other thread.
    virtual void run_handlers() {}
    /// Sends what was held back to be sent together.
    virtual void flush() = 0;
  };

  explicit IoLoop(const config::Clock& clock) : clock_(clock) {}
  ~IoLoop() { stop(); }
  IoLoop(const IoLoop&) = delete;
  IoLoop& operator=(const IoLoop&) = delete;

  /// Starts to serve the services, which must live until stop(). Further calls do nothing. Thread safe.
  void start(std::vector<Service*> services);
  /// Ends the threads once their handlers have returned. Not to be called from a handler.
  void stop();

  /// Has the loop ask all services for their wishes soon. Thread safe.
  void wake();
  /// Whether the calling thread is the serving thread, which needs no wake().
  bool serves() const { return server_ == std::this_thread::get_id(); }

  /// Sets whether what this thread's handlers send may wait for flush().
  void gather(bool on);
  bool gathers() const;
  void flush();

 private:
  void begin_thread() IOTCLOUD_REQUIRES(mutex_);
  void run();
  void stand_by() IOTCLOUD_REQUIRES(mutex_);
  void round();
  void run_handlers();
  int wait_ms(Instant until) const;

  const config::Clock& clock_;
  client::WakeEvent event_;
  std::atomic<std::thread::id> server_;   ///< the serving thread; default value: none yet
  std::atomic<std::thread::id> handler_;  ///< the serving thread, while it runs handlers
  std::atomic<std::uint64_t> rounds_ = 0;
  std::atomic<std::uint64_t> batches_ = 0;  ///< rounds in which handlers ran
  std::atomic<bool> watched_ = false;       ///< the thread that stands by checks every few milliseconds
  std::atomic<bool> ending_ = false;

  config::Mutex mutex_;
  config::ConditionVariable changed_;
  std::vector<std::thread> threads_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<Service*> services_;  ///< set before the threads start
};

}  // namespace iotcloud::brokers::activemq
