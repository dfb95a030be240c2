#include <cerrno>
#include <cstring>
#include <memory>
#include <mutex>
#include <utility>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/zookeeper/connection.h>
#include <iotcloud/discovery/zookeeper/handle.h>
#include <iotcloud/discovery/zookeeper/logger.h>

namespace iotcloud::discovery::zookeeper {
namespace {

/// Time for the server to hear that a session ends, so that its nodes are gone when the registry is closed.
constexpr std::chrono::milliseconds patience_at_end{500};

class ZooKeeperConnection : public RegistryConnection {
 public:
  explicit ZooKeeperConnection(Settings settings) : settings_(std::move(settings)) {}
  ~ZooKeeperConnection() override {
    ask_no_more();
    if (const auto last = replace(nullptr)) last->shut(patience_at_end);
  }
  ZooKeeperConnection(const ZooKeeperConnection&) = delete;
  ZooKeeperConnection& operator=(const ZooKeeperConnection&) = delete;

  bool open(Events events) override {
    events_ = std::move(events);
    return renew();
  }

  bool renew() override {
    if (const auto old = replace(nullptr)) old->shut(std::chrono::milliseconds::zero());
    auto fresh = Handle::open(settings_, events_);
    if (!fresh) {
      logger.debug("cannot begin to connect to {}: {}", settings_.url.hosts, std::strerror(errno));
      return false;
    }
    replace(std::move(fresh));
    return true;
  }

  bool ask_for_new(std::function<void()> serves) override {
    ask_no_more();
    const auto once = std::make_shared<std::once_flag>();
    Events events;
    events.connected = [once, serves = std::move(serves)](std::int64_t, std::chrono::milliseconds) {
      std::call_once(*once, serves);
    };
    events.disconnected = [] {};
    events.expired = [] {};
    events.changed = [](const std::string&) {};
    question_ = Handle::open(settings_, events);
    return question_ != nullptr;
  }

  void ask_no_more() override {
    if (const auto question = std::exchange(question_, nullptr)) question->shut(std::chrono::milliseconds::zero());
  }

  /// The client pings after a third of the time-out without traffic, and gives up a silent server after two thirds:
  /// when the client notices that, the server may have heard nothing for two thirds, too.
  std::chrono::milliseconds certain_after_disconnect(std::chrono::milliseconds timeout) const override {
    return timeout / 3;
  }

  std::chrono::milliseconds longest_attempt(std::chrono::milliseconds timeout) const override {
    return timeout * 2 / 3;
  }

  void create(const std::string& path, const std::string& data, bool ephemeral, bool sequential, const Fence& fence,
              Done done) override {
    const int mode = ephemeral ? (sequential ? ZOO_EPHEMERAL_SEQUENTIAL : ZOO_EPHEMERAL)
                               : (sequential ? ZOO_PERSISTENT_SEQUENTIAL : ZOO_PERSISTENT);
    with_handle(done, [&](Handle& handle) { handle.create(path, data, mode, fence, std::move(done)); });
  }

  void set(const std::string& path, const std::string& data, std::int64_t expected_version, const Fence& fence,
           Done done) override {
    with_handle(done, [&](Handle& handle) {
      handle.set(path, data, static_cast<int>(expected_version), fence, std::move(done));
    });
  }

  void remove(const std::string& path, std::int64_t expected_version, const Fence& fence, Done done) override {
    with_handle(
        done, [&](Handle& handle) { handle.remove(path, static_cast<int>(expected_version), fence, std::move(done)); });
  }

  void get(const std::string& path, bool watch, Done done) override {
    if (watch) {
      done = watching(path, std::move(done), [this, path](Done again) { get(path, true, std::move(again)); });
    }
    with_handle(done, [&](Handle& handle) { handle.get(path, watch, std::move(done)); });
  }

  void children(const std::string& path, bool watch, Done done) override {
    if (watch) {
      done = watching(path, std::move(done), [this, path](Done again) { children(path, true, std::move(again)); });
    }
    with_handle(done, [&](Handle& handle) { handle.children(path, watch, std::move(done)); });
  }

 private:
  /// A read of a missing node sets no watch; asking whether the node exists does. If the node was created in between,
  /// the read is repeated.
  Done watching(const std::string& path, Done done, std::function<void(Done)> read_again) {
    return [this, path, done = std::move(done), read_again = std::move(read_again)](Reply reply) {
      if (reply.status != ReplyStatus::no_node) {
        done(std::move(reply));
        return;
      }
      Done on_exists = [done, read_again](Reply exists) {
        if (exists.status == ReplyStatus::ok) {
          read_again(done);
        } else {
          done(std::move(exists));
        }
      };
      with_handle(on_exists, [&](Handle& handle) { handle.exists_watched(path, std::move(on_exists)); });
    };
  }

  template <typename Use>
  void with_handle(const Done& done, const Use& use) {
    std::shared_ptr<Handle> handle;
    {
      const config::MutexLock lock(mutex_);
      handle = handle_;
    }
    if (handle) {
      use(*handle);
    } else {
      done({});  // away
    }
  }

  std::shared_ptr<Handle> replace(std::shared_ptr<Handle> fresh) {
    const config::MutexLock lock(mutex_);
    return std::exchange(handle_, std::move(fresh));
  }

  const Settings settings_;
  Events events_;  ///< constant after open()
  config::Mutex mutex_;
  std::shared_ptr<Handle> handle_ IOTCLOUD_GUARDED_BY(mutex_);  ///< null between two sessions
  std::shared_ptr<Handle> question_;                            ///< a session only to see whether a server takes it
};

}  // namespace

std::unique_ptr<RegistryConnection> make_connection(Settings settings) {
  return std::make_unique<ZooKeeperConnection>(std::move(settings));
}

}  // namespace iotcloud::discovery::zookeeper
