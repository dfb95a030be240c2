#pragma once

#include <chrono>
#include <cstddef>
#include <exception>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/server_list.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/wire/link_sleep.h"
#include "iotcloud/brokers/server_trust.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::rabbitmq {

using client::ConnectionLog;

/// The life of one connection to a cluster, publishing or consuming, and the thread that leads it: connects to the
/// server whose turn it is, waits after failures, has its owner serve the connection, notices when it is broken, moves
/// it back to the preferred server when that one answers again, and closes it. What the connection carries is the
/// owner's.
///
/// One mutex, that of the owner's core, guards this object. Functions without a remark are called with the mutex held.
/// Waits and back-offs go by the injected clock.
class ConnectionLife {
 public:
  using Instant = config::Clock::Instant;

  /// What the socket was ready for when the thread woke up.
  struct Readiness {
    bool readable = true;  ///< also after a time-out, because reading handles heartbeats
    bool writable = false;
  };
  /// How the thread may wait for what comes next.
  struct Rest {
    bool unread = false;                 ///< received bytes wait that the socket does not show: do not wait at all
    std::chrono::milliseconds limit{0};  ///< 0: only looks at the socket
    int socket = -1;                     ///< the socket that ends the wait; -1: none
    bool want_write = false;
  };

  /// The connection itself. The life's thread calls these functions, with the mutex held unless another rule is given.
  class Owner {
   public:
    virtual ~Owner() = default;
    /// Connects to a server of the cluster and logs in; may take long. Called without the mutex. The connection is used
    /// from opened() on. \throws LinkError, or any other exception if it cannot
    virtual void open(std::size_t server) = 0;
    /// \return what the server showed; null: the connection has no TLS
    virtual std::shared_ptr<ShownChain> opened() = 0;
    /// Does what is due on the open connection; may release the mutex meanwhile. Any exception ends the connection.
    virtual void serve(Readiness ready) = 0;
    /// Calls back users (handlers, outcomes), also without a connection; may release the mutex meanwhile.
    virtual void call_back() = 0;
    virtual Rest rest() = 0;
    /// Whether nothing that was sent or handed on waits for an answer.
    virtual bool idle() const = 0;
    /// Sends what must be sent before the connection is closed on purpose; waits for the socket. \throws LinkError
    virtual void finish() = 0;
    /// Takes the connection out of use, once no other thread uses it, and forgets all that belonged to it.
    virtual void forget() = 0;
    /// Closes the connection that forget() took out of use. Called without the mutex. \param in_order with AMQP's
    /// closing handshake; otherwise it is broken
    virtual void close(bool in_order) noexcept = 0;
  };

  /// How long messages that were sent or handed on may take to be answered before the connection moves to the preferred
  /// server.
  static constexpr std::chrono::seconds moving_patience{2};
  /// How often this object checks whether they were answered.
  static constexpr std::chrono::milliseconds moving_period{50};

  /// All arguments outlive this object. \param name the thread's \param mutex the one of the owner's core
  ConnectionLife(const char* name, Owner& owner, config::Mutex& mutex, ConnectionSleep& sleep, const Cluster& cluster,
                 const config::Clock& clock, ConnectionLog& log);
  ~ConnectionLife() = default;  // begin_to_end() and join() were called
  ConnectionLife(const ConnectionLife&) = delete;
  ConnectionLife& operator=(const ConnectionLife&) = delete;

  /// Starts the thread unless the life is ending; wakes it if it runs already.
  void start();
  /// Has the thread close the connection and end. \return whether there is a thread, for which this caller must join()
  bool begin_to_end();
  /// Waits for the end of the thread. Called without the mutex, and not on that thread.
  void join();

  /// Wakes the thread if it sleeps.
  void wake() noexcept;
  /// The current exception, on any thread, shows that the connection is broken: the thread ends it.
  void broke() noexcept;

  /// Ends the connection if its server is not trusted any more. To be called often, without the mutex; reads files.
  void check_server();

  bool started() const;
  bool ending() const;
  /// Whether another thread found the connection broken, and it is still there.
  bool broken() const;
  bool sleeps() const;  ///< the thread sleeps, so only wake() or its sleep's end make it do something
  bool moving() const;  ///< the connection is about to move to the preferred server: nothing new is to be sent

  /// Whether it is time to probe the preferred server; preferred_answered() takes the result, after which the
  /// connection may move back. Both are called without the mutex.
  bool must_ask_preferred() const;
  void preferred_answered(bool answers);

 private:
  void run();
  void round() IOTCLOUD_REQUIRES(mutex_);
  void connect() IOTCLOUD_REQUIRES(mutex_);
  void lose(const std::string& reason) IOTCLOUD_REQUIRES(mutex_);
  void move_back() IOTCLOUD_REQUIRES(mutex_);
  void end() IOTCLOUD_REQUIRES(mutex_);
  void sleep() IOTCLOUD_REQUIRES(mutex_);
  /// Ends the open connection. Releases the mutex while it is closed.
  void part(bool in_order) IOTCLOUD_REQUIRES(mutex_);

  const char* const name_;
  Owner& owner_;
  config::Mutex& mutex_;
  ConnectionSleep& sleep_;
  const Cluster& cluster_;
  const config::Clock& clock_;
  ConnectionLog& log_;

  client::ServerList servers_ IOTCLOUD_GUARDED_BY(mutex_);
  bool started_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool ending_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool open_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool sleeping_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  Readiness ready_ IOTCLOUD_GUARDED_BY(mutex_);
  std::shared_ptr<ShownChain> shown_ IOTCLOUD_GUARDED_BY(mutex_);  ///< of the open connection
  /// Why another thread found the connection broken; null: none did.
  std::exception_ptr broken_ IOTCLOUD_GUARDED_BY(mutex_);
  /// Since when the connection is about to move; nullopt: it is not.
  std::optional<Instant> moving_since_ IOTCLOUD_GUARDED_BY(mutex_);
  std::thread thread_;
};

}  // namespace iotcloud::brokers::rabbitmq
