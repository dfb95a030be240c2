#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/state/redis/redis_address.h>
#include <iotcloud/topology/state/redis/redis_connection.h>

namespace iotcloud::topology::internal {

/// Connections to the master of a Redis, as many as threads ask at the same time: each thread waits for its own answer
/// only, and holds no lock meanwhile. When one connection fails, the pool gives up all of them, asks nobody for 200 ms,
/// and then asks all servers which of them is the master. It uses no server that may drop keys when its memory is full,
/// and none while two say that they are the master. Thread safe.
class RedisPool {
 public:
  /// \param clock outlives the pool
  explicit RedisPool(RedisAddress address, const config::Clock& clock = config::system_clock())
      : address_(std::move(address)), clock_(clock), trust_(address_.ca_file, address_.revoked_file) {}

  /// Looks for the master, unless there is a connection to it. \throws StateError if a server does not let this client
  /// in or may drop keys; StateUnavailable if there is no master now
  void connect();

  /// Sends a command to the master and waits for its answer, 2 s at most. \throws StateUnavailable whatever goes wrong:
  /// a server that became a replica, that is full or that restarts answers with an error
  RedisReply ask(const std::vector<std::string>& words);

  /// Asks whether the master still keeps all keys, at most once in a second. \throws StateUnavailable
  void make_sure();

  /// The script with a beginning that refuses to run on a server that may drop keys.
  static std::string for_a_server_that_keeps_all(const std::string& script);

 private:
  /// A connection that one thread uses.
  struct Lent {
    std::unique_ptr<RedisConnection> connection;
    std::uint64_t generation = 0;
  };

  Lent take();
  void give_back(Lent lent);
  Lent open(std::uint64_t generation, const std::optional<RedisServer>& master);
  std::unique_ptr<RedisConnection> open_master(const std::vector<RedisServer>& servers);
  std::string greet(RedisConnection& server);
  std::uint64_t found(std::uint64_t generation, const RedisConnection& master);
  void give_up(std::uint64_t generation, std::string problem);
  void begin_generation() IOTCLOUD_REQUIRES(mutex_);

  const RedisAddress address_;
  const config::Clock& clock_;
  brokers::ServerTrust trust_;
  config::Mutex mutex_;  ///< no thread holds it while it waits for a server
  std::vector<std::unique_ptr<RedisConnection>> idle_ IOTCLOUD_GUARDED_BY(mutex_);
  /// How often all connections were given up; those that were lent before the last time are not taken back.
  std::uint64_t generation_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  /// The server of this generation's connections; empty: none was opened.
  std::optional<RedisServer> server_ IOTCLOUD_GUARDED_BY(mutex_);
  config::Clock::Instant again_at_ IOTCLOUD_GUARDED_BY(mutex_){};  ///< no attempt to connect before this time
  config::Clock::Instant look_at_ IOTCLOUD_GUARDED_BY(mutex_){};   ///< make_sure() does not ask before this time
  std::string last_problem_ IOTCLOUD_GUARDED_BY(mutex_);           ///< why the pool gave up its connections last
  std::string master_ IOTCLOUD_GUARDED_BY(mutex_);  ///< RedisConnection::name() of the last; empty: there was none
  std::set<std::string> told_of_restarts_ IOTCLOUD_GUARDED_BY(mutex_);  ///< names of servers
};

}  // namespace iotcloud::topology::internal
