#pragma once

#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/embedded/server_state.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::embedded {

/// A consumer together with what runs for it: settles deliveries and owns the handler.
class Reader final : public Settler, public Consumer, public std::enable_shared_from_this<Reader> {
 public:
  Reader(std::shared_ptr<ServerState> server, std::shared_ptr<Connection> owner, Handler handler_to_run);
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;

  const Handler handler;

 private:
  const std::shared_ptr<ServerState> server_;
  const std::shared_ptr<Connection> owner_;
};

/// One broker object's link to the server, with the one thread that runs its handlers and reports its outcomes.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(std::shared_ptr<ServerState> server, const config::Clock& clock, Meters meters);
  /// The thread must have been joined: close().
  ~Connection() = default;
  void open();
  void close();

  /// Ends the thread's sleep. Thread safe.
  void wake();
  bool on_own_thread() const { return std::this_thread::get_id() == thread_.get_id(); }

  /// Calls the callbacks of one producer on the calling thread; `lock` holds the server's mutex and is released
  /// meanwhile. Waits when another thread does so already.
  void report(const std::shared_ptr<Producer>& producer, std::unique_lock<std::mutex>& lock);

  const std::shared_ptr<ServerState> server;
  const config::Clock& clock;
  Meters meters;

  // Guarded by the server's mutex.
  std::vector<std::shared_ptr<Reader>> consumers;
  std::deque<std::shared_ptr<Consumer>> ready;  ///< those with something to take
  std::vector<Producer*> producers;
  std::deque<std::shared_ptr<Producer>> to_report;
  std::vector<Producer*> timed;     ///< producers with messages that wait and grow old
  std::condition_variable changed;  ///< a handler or a callback ended, an outcome was reported
  bool sleeping = false;

 private:
  void run();
  bool deliver_next(std::unique_lock<std::mutex>& lock);
  void run_handler(const std::shared_ptr<Reader>& reader, Stored stored, std::uint64_t tag);
  std::optional<Instant> next_deadline(Instant now);
  void sleep(std::optional<Instant> until);

  bool closing_ = false;  ///< guarded by the server's mutex
  std::mutex sleep_mutex_;
  std::condition_variable sleep_over_;
  bool woken_ = false;  ///< guarded by sleep_mutex_
  std::thread thread_;
};

}  // namespace iotcloud::brokers::embedded
