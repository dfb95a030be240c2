#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include <hiredis/read.h>
#include <openssl/ssl.h>

#include "iotcloud/brokers/server_trust.h"
#include <iotcloud/topology/state/redis/redis_address.h>
#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::internal {

/// An answer of a server.
struct RedisReply {
  bool is_nothing = false;  ///< the server has no such value
  std::string text;         ///< also of a number, in decimal
  std::vector<RedisReply> list;
};

/// A server refused a command. The text is the server's: "NOAUTH Authentication required.".
class RedisRefusal : public StateError {
 public:
  using StateError::StateError;
};

/// One connection to a server, plain or with TLS. hiredis encodes commands and decodes answers; the transport is our
/// own, because Debian's hiredis (0.14) has no TLS. Not thread safe. Destroy it after it has thrown StateUnavailable:
/// an answer may still be under way.
class RedisConnection {
 public:
  /// Connects. \param limit for this, and for each later answer. \param trust of the address's files; outlives this
  /// object. \throws StateUnavailable; StateError if a file cannot be used
  RedisConnection(const RedisAddress& address, const RedisServer& server, std::chrono::milliseconds limit,
                  brokers::ServerTrust& trust);
  ~RedisConnection();
  RedisConnection(const RedisConnection&) = delete;
  RedisConnection& operator=(const RedisConnection&) = delete;

  /// Sends a command and waits for its answer. Words are any bytes. \throws StateUnavailable; RedisRefusal
  RedisReply ask(const std::vector<std::string>& words);
  /// To be called before each command: says so if the server is not trusted any more. \throws StateUnavailable
  void check_server(brokers::ServerTrust::Instant now);
  /// "HOST:PORT"
  const std::string& name() const { return name_; }
  const RedisServer& server() const { return server_; }

 private:
  using Instant = std::chrono::steady_clock::time_point;
  void connect(const RedisServer& server);
  void begin_tls(const RedisAddress& address, const RedisServer& server);
  void send(std::string_view bytes);
  std::size_t receive(char* place, std::size_t size);  ///< at least one byte
  void send_plain(std::string_view bytes);
  std::size_t receive_plain(char* place, std::size_t size);
  void send_encrypted();     ///< what the TLS engine has to send
  void receive_encrypted();  ///< gives the TLS engine what comes next
  void wait(short events);
  [[noreturn]] void fail(const std::string& what) const;

  const std::chrono::milliseconds limit_;
  const RedisServer server_;
  const std::string name_;
  brokers::ServerTrust& trust_;
  int socket_ = -1;
  Instant end_{};  ///< when the step that is under way must be done
  struct Free {
    void operator()(SSL_CTX* context) const { SSL_CTX_free(context); }
    void operator()(SSL* engine) const { SSL_free(engine); }
    void operator()(redisReader* reader) const { redisReaderFree(reader); }
  };
  std::shared_ptr<brokers::ShownChain> shown_;  ///< null: plain. Outlives context_
  std::unique_ptr<SSL_CTX, Free> context_;
  std::unique_ptr<SSL, Free> tls_;  ///< null: plain. Reads and writes memory; send_encrypted() and receive_encrypted()
  std::unique_ptr<redisReader, Free> reader_;
};

}  // namespace iotcloud::topology::internal
