#pragma once

#include <deque>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/embedded/server_state.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::embedded {

/// A subscription: a consumer of the server with its handler, which also settles the handler's deliveries.
class HandlerConsumer final : public Settler, public Consumer, public std::enable_shared_from_this<HandlerConsumer> {
 public:
  HandlerConsumer(std::shared_ptr<ServerState> server, std::shared_ptr<EmbeddedConnection> owner,
                  Handler handler_to_run);
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;

  const Handler handler;

 private:
  const std::shared_ptr<ServerState> server_;
  const std::shared_ptr<EmbeddedConnection> owner_;
};

/// A broker object's connection to the server, with the one thread that runs its handlers and reports its outcomes.
class EmbeddedConnection : public std::enable_shared_from_this<EmbeddedConnection> {
 public:
  EmbeddedConnection(std::shared_ptr<ServerState> server, const config::Clock& clock, Meters meters);
  /// \pre close() was called.
  ~EmbeddedConnection() = default;
  /// Joins the server and starts the thread.
  void open();
  /// Joins the thread and leaves the server.
  void close();

  /// Wakes the thread. Thread safe.
  void wake();
  bool on_own_thread() const { return std::this_thread::get_id() == thread_.get_id(); }

  const std::shared_ptr<ServerState> server;
  const config::Clock& clock;
  Meters meters;

  /// For code that holds the server's mutex under another name. Does nothing at run time.
  void assert_held() const IOTCLOUD_ASSERT_CAPABILITY(server->mutex) {}
  /// Calls one publisher's callbacks on the calling thread. The server's mutex is released during the calls. If another
  /// thread calls this publisher's callbacks already, waits until it has done so.
  void report(const std::shared_ptr<ServerPublisher>& publisher) IOTCLOUD_REQUIRES(server->mutex);

  std::vector<std::shared_ptr<HandlerConsumer>> consumers IOTCLOUD_GUARDED_BY(server->mutex);
  std::deque<std::shared_ptr<Consumer>> ready IOTCLOUD_GUARDED_BY(server->mutex);  ///< consumers with messages to take
  std::vector<ServerPublisher*> publishers IOTCLOUD_GUARDED_BY(server->mutex);
  std::deque<std::shared_ptr<ServerPublisher>> to_report IOTCLOUD_GUARDED_BY(server->mutex);
  /// Publishers whose waiting messages have a deadline.
  std::vector<ServerPublisher*> timed IOTCLOUD_GUARDED_BY(server->mutex);
  config::ConditionVariable changed;  ///< signals that a handler or callback ended, or that an outcome was reported
  /// The thread waits in sleep(), so it must be woken for work.
  bool sleeping IOTCLOUD_GUARDED_BY(server->mutex) = false;

 private:
  void run();
  bool deliver_next() IOTCLOUD_REQUIRES(server->mutex);
  static void call_back(const ServerPublisher& publisher, const std::vector<ServerPublisher::Event>& events,
                        bool writable);
  void run_handler(const std::shared_ptr<HandlerConsumer>& reader, StoredMessage stored, std::uint64_t tag);
  std::optional<Instant> next_deadline(Instant now) IOTCLOUD_REQUIRES(server->mutex);
  void sleep(std::optional<Instant> until);

  bool closing_ IOTCLOUD_GUARDED_BY(server->mutex) = false;
  config::Mutex sleep_mutex_;
  config::ConditionVariable sleep_over_;
  bool woken_ IOTCLOUD_GUARDED_BY(sleep_mutex_) = false;
  std::thread thread_;
};

}  // namespace iotcloud::brokers::embedded
