#include <algorithm>
#include <initializer_list>
#include <set>
#include <span>
#include <utility>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/client/batch.h>
#include <iotcloud/discovery/client/client_state.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/client/registry_client.h>
#include <iotcloud/discovery/logger.h>

namespace iotcloud::discovery {
namespace {

void check(const std::string& path, const std::string& data) {
  check_path(path);
  if (data.size() > max_node_size) {
    throw RegistryError(RegistryErrorCode::too_large, path + ": " + std::to_string(data.size()) +
                                                          " bytes are more than a node takes (" +
                                                          std::to_string(max_node_size) + ")");
  }
}

/// The error for a write whose repetition shows that either its first attempt, whose answer was lost, or another
/// client's write took effect.
RegistryError doubt(const std::string& what) {
  return RegistryError(RegistryErrorCode::away,
                       what + ": the connection was lost meanwhile; whether it took effect is unknown");
}

bool is_one_of(ReplyStatus status, std::initializer_list<ReplyStatus> some) {
  return std::find(some.begin(), some.end(), status) != some.end();
}

RegistryError refusal(const std::string& what, ReplyStatus status) {
  switch (status) {
    case ReplyStatus::no_node:
      return RegistryError(RegistryErrorCode::no_node, what + ": no such node");
    case ReplyStatus::exists:
      return RegistryError(RegistryErrorCode::exists, what + ": it exists already");
    case ReplyStatus::not_empty:
      return RegistryError(RegistryErrorCode::not_empty, what + ": it has children");
    case ReplyStatus::bad_version:
      return RegistryError(RegistryErrorCode::bad_version, what + ": it was changed meanwhile");
    case ReplyStatus::bad_path:
      return RegistryError(RegistryErrorCode::bad_path, what +
                                                            ": no such path is possible (an ephemeral node cannot "
                                                            "have children, and the root cannot be removed)");
    case ReplyStatus::denied:
      return RegistryError(RegistryErrorCode::denied,
                           what +
                               ": it belongs to another user of the registry; are registry.user and "
                               "registry.password_file those of the process that created it? With registry.users it "
                               "is also so until the first master has made what all records are below");
    case ReplyStatus::fenced:
      return RegistryError(RegistryErrorCode::fenced,
                           what + ": its fence is gone: what it was to depend on does not hold any more");
    case ReplyStatus::ok:
    case ReplyStatus::away:
      break;
  }
  return RegistryError(RegistryErrorCode::away, what + ": no answer");
}

class RegistryClient : public Registry {
 public:
  RegistryClient(std::unique_ptr<RegistryConnection> connection, const RegistryOptions& options)
      : core_(std::make_shared<ClientState>(std::move(connection), options)) {
    core_->open();
  }
  ~RegistryClient() override { core_->close(); }
  RegistryClient(const RegistryClient&) = delete;
  RegistryClient& operator=(const RegistryClient&) = delete;

  void create(const std::string& path, const std::string& data, bool parents, const Fence& fence) override {
    check(path, data);
    const std::string what = "create " + path;
    if (path == "/") throw refusal(what, ReplyStatus::exists);
    for (;;) {
      bool in_doubt = false;
      const Reply reply = core_->call(
          what,
          [&](RegistryConnection& connection, Done done) {
            connection.create(path, data, false, false, fence, std::move(done));
          },
          &in_doubt);
      if (reply.status == ReplyStatus::ok) return;
      if (in_doubt && is_one_of(reply.status, {ReplyStatus::exists, ReplyStatus::fenced})) throw doubt(what);
      if (reply.status != ReplyStatus::no_node || !parents || parent_of(path) == "/") throw refusal(what, reply.status);
      make(parent_of(path), fence);
    }
  }

  void set(const std::string& path, const std::string& data, std::int64_t expected_version,
           const Fence& fence) override {
    check(path, data);
    const std::string what = "set " + path;
    bool in_doubt = false;
    const Reply reply = core_->call(
        what,
        [&](RegistryConnection& connection, Done done) {
          connection.set(path, data, expected_version, fence, std::move(done));
        },
        &in_doubt);
    if (in_doubt && is_one_of(reply.status, {ReplyStatus::bad_version, ReplyStatus::fenced})) throw doubt(what);
    if (reply.status != ReplyStatus::ok) throw refusal(what, reply.status);
  }

  std::optional<Node> get(const std::string& path) override {
    check_path(path);
    Reply reply = core_->call(
        "get " + path, [&](RegistryConnection& connection, Done done) { connection.get(path, false, std::move(done)); },
        nullptr);
    if (reply.status == ReplyStatus::no_node) return std::nullopt;
    if (reply.status != ReplyStatus::ok) throw refusal("get " + path, reply.status);
    return std::move(reply.node);
  }

  bool remove(const std::string& path, std::int64_t expected_version, const Fence& fence) override {
    check_path(path);
    const std::string what = "remove " + path;
    if (path == "/") throw refusal(what, ReplyStatus::bad_path);
    bool in_doubt = false;
    const Reply reply = core_->call(
        what,
        [&](RegistryConnection& connection, Done done) {
          connection.remove(path, expected_version, fence, std::move(done));
        },
        &in_doubt);
    if (reply.status == ReplyStatus::ok) return true;
    if (reply.status == ReplyStatus::no_node) return in_doubt;
    if (in_doubt && is_one_of(reply.status, {ReplyStatus::bad_version, ReplyStatus::fenced})) throw doubt(what);
    throw refusal(what, reply.status);
  }

  std::optional<std::vector<std::string>> children(const std::string& path) override {
    check_path(path);
    Reply reply = core_->call(
        "children of " + path,
        [&](RegistryConnection& connection, Done done) { connection.children(path, false, std::move(done)); }, nullptr);
    if (reply.status == ReplyStatus::no_node) return std::nullopt;
    if (reply.status != ReplyStatus::ok) throw refusal("children of " + path, reply.status);
    return std::move(reply.names);
  }

  std::vector<std::optional<Node>> get_all(const std::vector<std::string>& paths) override {
    return nodes_at(paths, Denied::throws);
  }
  std::vector<std::optional<std::vector<std::string>>> children_of_all(const std::vector<std::string>& paths) override {
    return children_at(paths, Denied::throws);
  }
  std::vector<std::optional<Node>> get_readable(const std::vector<std::string>& paths) override {
    return nodes_at(paths, Denied::counts_as_absent);
  }
  std::vector<std::optional<std::vector<std::string>>> children_of_readable(
      const std::vector<std::string>& paths) override {
    return children_at(paths, Denied::counts_as_absent);
  }

  GuardPtr hold(const std::string& path, const std::string& data, bool sequential,
                std::function<void(const std::string&)> on_created) override {
    return start_hold(path, data, sequential, std::move(on_created), true);
  }

  GuardPtr hold_eventually(const std::string& path, const std::string& data, bool sequential,
                           std::function<void(const std::string&)> on_created) override {
    return start_hold(path, data, sequential, std::move(on_created), false);
  }

  GuardPtr watch_node(const std::string& path, std::function<void(const std::optional<Node>&)> callback) override {
    check_path(path);
    auto watch = std::make_shared<Watch>();
    watch->path = path;
    watch->on_node = std::make_shared<NodeCallback>(std::move(callback));
    return core_->add_watch(std::move(watch));
  }

  GuardPtr watch_children(const std::string& path,
                          std::function<void(const std::optional<std::vector<std::string>>&)> callback) override {
    check_path(path);
    auto watch = std::make_shared<Watch>();
    watch->path = path;
    watch->on_children = std::make_shared<ChildrenCallback>(
        [callback = std::move(callback)](const SharedNames& names) { callback(*names); });
    return core_->add_watch(std::move(watch));
  }

  SessionState session() const override { return core_->session(); }
  GuardPtr on_session(std::function<void(SessionState)> callback) override {
    return core_->add_listener(std::move(callback));
  }
  GuardPtr after(std::chrono::milliseconds pause, std::function<void()> callback) override {
    return core_->add_timer(pause, std::move(callback));
  }

 private:
  /// Makes a persistent, empty node and its parents. Accepts a node that exists already.
  void make(const std::string& path, const Fence& fence) {
    try {
      create(path, "", true, fence);
    } catch (const RegistryError& error) {
      if (error.code() == RegistryErrorCode::exists) return;
      if (error.code() != RegistryErrorCode::away || !get(path)) throw;  // the answer was lost, but the node exists
    }
  }

  /// What a node does to a reading that it keeps out.
  enum class Denied { throws, counts_as_absent };

  std::vector<std::optional<Node>> nodes_at(const std::vector<std::string>& paths, Denied denied) {
    const auto read = [](RegistryConnection& connection, const std::string& path, Done done) {
      connection.get(path, false, std::move(done));
    };
    return answers<Node>("get ", paths, denied, read, [](Reply& reply) { return std::move(reply.node); });
  }

  std::vector<std::optional<std::vector<std::string>>> children_at(const std::vector<std::string>& paths,
                                                                   Denied denied) {
    const auto read = [](RegistryConnection& connection, const std::string& path, Done done) {
      connection.children(path, false, std::move(done));
    };
    return answers<std::vector<std::string>>("children of ", paths, denied, read,
                                             [](Reply& reply) { return std::move(reply.names); });
  }

  template <typename Answer, typename Take>
  std::vector<std::optional<Answer>> answers(const std::string& what, const std::vector<std::string>& paths,
                                             Denied denied, const Batch::Read& read, const Take& take) {
    std::vector<std::optional<Answer>> found;
    found.reserve(paths.size());
    std::vector<std::string> shut;
    for_each_answer(what, paths, read, [&](const std::string& path, Reply& reply) {
      if (reply.status == ReplyStatus::ok) {
        found.emplace_back(take(reply));
        return;
      }
      const bool is_shut = reply.status == ReplyStatus::denied && denied == Denied::counts_as_absent;
      if (!is_shut && reply.status != ReplyStatus::no_node) throw refusal(what + path, reply.status);
      if (is_shut) shut.push_back(path);
      found.emplace_back();
    });
    tell_of(shut);
    return found;
  }

  /// Logs nodes that keep this user out, each once: lists are read again and again. Whoever makes many of them fills
  /// neither the log nor the memory.
  void tell_of(const std::vector<std::string>& shut) {
    constexpr std::size_t most_told = 100;
    const config::MutexLock lock(mutex_);
    for (const auto& path : shut) {
      if (told_.size() == most_told || !told_.insert(path).second) continue;
      logger.warn("{} counts as absent, because it keeps this process out; `iotcloud registry rights` says what to do",
                  path);
    }
  }

  /// Reads in batches; the operation time-out counts for each batch.
  void for_each_answer(const std::string& what, const std::vector<std::string>& paths, const Batch::Read& read,
                       const std::function<void(const std::string&, Reply&)>& use) {
    for (const std::string& path : paths) check_path(path);
    for (std::size_t begin = 0; begin < paths.size(); begin += Batch::size) {
      const std::span<const std::string> part(paths.data() + begin, std::min(Batch::size, paths.size() - begin));
      std::shared_ptr<Batch> batch;
      core_->call(
          what + part.front() + (part.size() > 1 ? " and others" : ""),
          [&](RegistryConnection& connection, Done done) {
            batch = Batch::start(connection, part, read, std::move(done));
          },
          nullptr);
      for (std::size_t i = 0; i < part.size(); ++i) use(part[i], batch->replies()[i]);
    }
  }

  GuardPtr start_hold(const std::string& path, const std::string& data, bool sequential,
                      std::function<void(const std::string&)> on_created, bool wait) {
    check(sequential ? path + "0" : path, data);
    auto hold = std::make_shared<Hold>();
    hold->path = path;
    hold->data = data;
    hold->sequential = sequential;
    hold->on_created = std::make_shared<Callback<std::string>>(std::move(on_created));
    ReplyStatus status = ReplyStatus::ok;
    GuardPtr guard = core_->add_hold(std::move(hold), wait, status);
    if (!guard) throw refusal("create " + path, status);
    return guard;
  }

  const std::shared_ptr<ClientState> core_;
  config::Mutex mutex_;
  std::set<std::string> told_ IOTCLOUD_GUARDED_BY(mutex_);  ///< nodes that keep this user out, of which the log tells
};

}  // namespace

std::unique_ptr<Registry> make_client(std::unique_ptr<RegistryConnection> connection, const RegistryOptions& options) {
  return std::make_unique<RegistryClient>(std::move(connection), options);
}

}  // namespace iotcloud::discovery
