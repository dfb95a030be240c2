#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/discovery/client/connection.h>

namespace iotcloud::discovery::embedded {

/// The in-process registry: ZooKeeper's model (sessions, ephemeral and sequential nodes, versions, one-shot watches)
/// without a process of its own. Nothing is stored: the tree lives as long as somebody refers to the server.
/// Sessions expire only when a test says so, since within one process nobody dies alone. Thread safe.
class Server : public std::enable_shared_from_this<Server> {
 public:
  /// The server of that name, made when there is none. It dies with the last who refers to it.
  static std::shared_ptr<Server> named(const std::string& name);

  Server();

  /// Sessions that live, oldest first; those partitioned too.
  std::vector<std::int64_t> sessions() const;
  /// Cuts a session's client off: its operations fail and it hears nothing; the session lives on.
  void partition(std::int64_t session);
  /// The session's next creation takes effect, but it is cut off before it hears so.
  void partition_before_next_answer(std::int64_t session);
  /// The client reaches the server again: under its old session, or hears that it expired meanwhile.
  void restore(std::int64_t session);
  /// Away for everybody, clients that come now included, as if the server were down; sessions live on.
  void stop();
  void start();
  /// The session's ephemeral nodes go; its client hears of it at once, or when restored.
  void expire(std::int64_t session);

  /// \name For the connection only.
  /// `events` are called with the server locked: they must not call back.
  /// @{
  std::int64_t open_session(Connection::Events events, std::chrono::milliseconds timeout);
  void close_session(std::int64_t session);
  void create(std::int64_t session, const std::string& path, const std::string& data, bool ephemeral, bool sequential,
              const Fence& fence, const Done& done);
  void set(std::int64_t session, const std::string& path, const std::string& data, std::int64_t expected_version,
           const Fence& fence, const Done& done);
  void remove(std::int64_t session, const std::string& path, std::int64_t expected_version, const Fence& fence,
              const Done& done);
  void get(std::int64_t session, const std::string& path, bool watch, const Done& done);
  void children(std::int64_t session, const std::string& path, bool watch, const Done& done);
  /// @}

 private:
  struct Entry {
    Node node;
    std::set<std::string> children;
    std::uint32_t next_sequence = 0;
  };
  struct Session {
    Connection::Events events;
    std::chrono::milliseconds timeout{0};
    bool reachable = true;
    bool loses_answer = false;         ///< of the next creation
    bool expired = false;              ///< but its client does not know yet
    std::vector<std::string> to_tell;  ///< watches that fired while it was not reachable
  };
  using Watchers = std::map<std::string, std::set<std::int64_t>>;  ///< by path

  void cut_off(Session& session);
  void let_in(std::int64_t number);
  bool reachable(std::int64_t session) const;
  bool stands(const Fence& fence) const { return fence.path.empty() || tree_.contains(fence.path); }
  Status put_node(std::int64_t session, const std::string& path, const std::string& data, bool ephemeral,
                  bool sequential, std::string& real_path);
  void erase(const std::string& path);
  void drop_nodes(std::int64_t session);
  void forget_watches(std::int64_t session);
  void fire(Watchers& watchers, const std::string& path);

  mutable std::mutex mutex_;
  // Guarded by mutex_:
  std::map<std::string, Entry> tree_;
  std::map<std::int64_t, Session> sessions_;
  Watchers node_watchers_;
  Watchers children_watchers_;
  std::int64_t last_change_ = 0;
  std::int64_t last_session_ = 0;
  bool down_ = false;
};

/// A connection to a server; its session's number is seen in Server::sessions().
std::unique_ptr<Connection> make_connection(std::shared_ptr<Server> server, std::chrono::milliseconds session_timeout);

}  // namespace iotcloud::discovery::embedded
