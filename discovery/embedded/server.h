#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/client/connection.h>

namespace iotcloud::discovery::embedded {

/// The in-process registry: ZooKeeper's model (sessions, ephemeral and sequential nodes, versions, one-shot watches)
/// without a process of its own. Nothing is stored on disk: the tree lives as long as somebody refers to the server.
/// Only tests expire sessions, because within one process no client dies alone. Thread safe.
class RegistryServer : public std::enable_shared_from_this<RegistryServer> {
 public:
  /// The server of that name, made if it does not exist. It is destroyed with its last user.
  static std::shared_ptr<RegistryServer> named(const std::string& name);

  RegistryServer();

  /// Node::modified_ms is of this clock from now on. \param clock outlives the server
  void keep_time_by(const config::Clock& clock);
  /// Live sessions, oldest first, including partitioned ones.
  std::vector<std::int64_t> sessions() const;
  /// Cuts a session's client off: its operations fail and it hears no events; the session lives on.
  void partition(std::int64_t session);
  /// The session's next creation takes effect, but the client is cut off before it gets the answer.
  void partition_before_next_answer(std::int64_t session);
  /// Lets the client connect again: to its old session, or, if that expired meanwhile, the client is told so.
  void restore(std::int64_t session);
  /// Cuts off all clients, new ones included, as if the server were down; sessions live on.
  void stop();
  void start();
  /// Removes the session's ephemeral nodes; its client hears of it at once, or when restored.
  void expire(std::int64_t session);
  /// The persistent nodes as they are now, as a backup of the server's disk has them.
  struct Image;
  std::shared_ptr<const Image> image() const;
  /// Puts an earlier state in place of all nodes; null: an empty tree. As ZooKeeper does, the server never lets clients
  /// in again that have seen a later state; it does not tell them why.
  void put_back(const std::shared_ptr<const Image>& image);
  /// Whether a client that is cut off waits to hear that the server takes new sessions.
  bool is_asked() const;

  /// \name For the connection only.
  /// `events` are called with the server locked: they must not call back.
  /// @{
  std::int64_t open_session(RegistryConnection::Events events, std::chrono::milliseconds timeout);
  /// Calls back once, at once or later, when the server takes new sessions. \return a number for ask_no_more().
  std::int64_t ask_for_new(std::function<void()> serves);
  void ask_no_more(std::int64_t question);
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
    RegistryConnection::Events events;
    std::chrono::milliseconds timeout{0};
    bool reachable = true;
    bool loses_answer = false;         ///< the next creation's answer gets lost
    bool refused = false;              ///< the client has seen a later state of the tree
    bool expired = false;              ///< the session has expired, but its client was cut off and does not know yet
    std::vector<std::string> to_tell;  ///< watches that fired while the client was cut off
  };
  using Watchers = std::map<std::string, std::set<std::int64_t>>;  ///< by path

  /// Answers a request that changes nothing. \param watchers to which the session is added for this path; null: the
  /// request sets no watch.
  /// \param fill takes (Reply&, const Entry&), and is called when the node is there.
  template <typename Fill>
  void read(std::int64_t session, const std::string& path, Watchers* watchers, const Done& done, Fill&& fill)
      IOTCLOUD_EXCLUDES(mutex_);
  void cut_off(Session& session) IOTCLOUD_REQUIRES(mutex_);
  void let_in(std::int64_t number) IOTCLOUD_REQUIRES(mutex_);
  bool reachable(std::int64_t session) const IOTCLOUD_REQUIRES(mutex_);
  bool stands(const Fence& fence) const IOTCLOUD_REQUIRES(mutex_) {
    return fence.path.empty() || tree_.contains(fence.path);
  }
  ReplyStatus put_node(std::int64_t session, const std::string& path, const std::string& data, bool ephemeral,
                       bool sequential, std::string& real_path) IOTCLOUD_REQUIRES(mutex_);
  void erase(const std::string& path) IOTCLOUD_REQUIRES(mutex_);
  void drop_nodes(std::int64_t session) IOTCLOUD_REQUIRES(mutex_);
  void forget_watches(std::int64_t session) IOTCLOUD_REQUIRES(mutex_);
  void fire(Watchers& watchers, const std::string& path) IOTCLOUD_REQUIRES(mutex_);

  mutable config::Mutex mutex_;
  std::map<std::string, Entry> tree_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<std::int64_t, Session> sessions_ IOTCLOUD_GUARDED_BY(mutex_);
  Watchers node_watchers_ IOTCLOUD_GUARDED_BY(mutex_);
  Watchers children_watchers_ IOTCLOUD_GUARDED_BY(mutex_);
  const config::Clock* clock_ IOTCLOUD_GUARDED_BY(mutex_) = &config::system_clock();
  std::int64_t last_change_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::int64_t last_session_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  bool down_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::map<std::int64_t, std::function<void()>> questions_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by ask_for_new()
  std::int64_t last_question_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
};

struct RegistryServer::Image {
  std::map<std::string, Entry> tree;
  std::int64_t last_change = 0;
};

/// Connects to a server; RegistryServer::sessions() has the number of its session.
std::unique_ptr<RegistryConnection> make_connection(std::shared_ptr<RegistryServer> server,
                                                    std::chrono::milliseconds session_timeout);

}  // namespace iotcloud::discovery::embedded
