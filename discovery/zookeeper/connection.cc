#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <shared_mutex>
#include <utility>

#include <zookeeper/zookeeper.h>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/zookeeper/connection.h>

namespace iotcloud::discovery::zookeeper {
namespace {

const config::Logger log{"discovery.zookeeper"};

Status to_status(int code) {
  switch (code) {
    case ZOK:
      return Status::ok;
    case ZNONODE:
      return Status::no_node;
    case ZNODEEXISTS:
      return Status::exists;
    case ZNOTEMPTY:
      return Status::not_empty;
    case ZBADVERSION:
      return Status::bad_version;
    case ZNOCHILDRENFOREPHEMERALS:
    case ZBADARGUMENTS:
    case ZNOAUTH:
      return Status::bad_path;
    default:
      return Status::away;  // connection or session lost, or on its way there
  }
}

Reply with_status(int code) {
  Reply reply;
  reply.status = to_status(code);
  return reply;
}

Node to_node(const char* data, int size, const Stat& stat) {
  Node node;
  if (data != nullptr && size > 0) node.data.assign(data, static_cast<std::size_t>(size));
  node.version = stat.version;
  node.created = stat.czxid;
  node.ephemeral = stat.ephemeralOwner != 0;
  node.owner_session = stat.ephemeralOwner;
  return node;
}

/// The library's messages are for its maintainers; what users need to know the registry client says.
void library_log(const char* message) {
  log.debug("{}", message);
}

class ZooKeeperConnection : public Connection {
 public:
  ZooKeeperConnection(Url url, std::chrono::milliseconds timeout) : url_(std::move(url)), timeout_(timeout) {}
  ~ZooKeeperConnection() override { close(); }
  ZooKeeperConnection(const ZooKeeperConnection&) = delete;
  ZooKeeperConnection& operator=(const ZooKeeperConnection&) = delete;

  bool open(Events events) override {
    events_ = std::move(events);
    return renew();
  }

  bool renew() override {
    static std::once_flag once;
    std::call_once(once, [] { zoo_set_debug_level(ZOO_LOG_LEVEL_WARN); });
    close();
    zhandle_t* handle =
        zookeeper_init2(url_.hosts.c_str(), &ZooKeeperConnection::on_event, static_cast<int>(timeout_.count()), nullptr,
                        this, ZOO_NO_LOG_CLIENTENV, &library_log);
    if (handle == nullptr) log.debug("cannot begin to connect to {}: {}", url_.hosts, std::strerror(errno));
    const std::unique_lock lock(mutex_);
    handle_ = handle;
    return handle != nullptr;
  }

  /// The client pings after a third of the time-out without traffic, and gives a silent server up after two thirds:
  /// when it notices, the server may have heard nothing for two thirds already.
  std::chrono::milliseconds certain_after_disconnect(std::chrono::milliseconds timeout) const override {
    return timeout / 3;
  }

  void create(const std::string& path, const std::string& data, bool ephemeral, bool sequential, Done done) override {
    const int mode = ephemeral ? (sequential ? ZOO_EPHEMERAL_SEQUENTIAL : ZOO_EPHEMERAL)
                               : (sequential ? ZOO_PERSISTENT_SEQUENTIAL : ZOO_PERSISTENT);
    start(std::move(done), [&](zhandle_t* handle, const void* request) {
      return zoo_acreate(handle, full(path).c_str(), data.data(), static_cast<int>(data.size()), &ZOO_OPEN_ACL_UNSAFE,
                         mode, &ZooKeeperConnection::on_created, request);
    });
  }

  void set(const std::string& path, const std::string& data, std::int64_t expected_version, Done done) override {
    start(std::move(done), [&](zhandle_t* handle, const void* request) {
      return zoo_aset(handle, full(path).c_str(), data.data(), static_cast<int>(data.size()),
                      static_cast<int>(expected_version), &ZooKeeperConnection::on_stat, request);
    });
  }

  void remove(const std::string& path, std::int64_t expected_version, Done done) override {
    start(std::move(done), [&](zhandle_t* handle, const void* request) {
      return zoo_adelete(handle, full(path).c_str(), static_cast<int>(expected_version),
                         &ZooKeeperConnection::on_removed, request);
    });
  }

  void get(const std::string& path, bool watch, Done done) override {
    if (watch) {
      done = watching(path, std::move(done), [this, path](Done again) { get(path, true, std::move(again)); });
    }
    start(std::move(done), [&](zhandle_t* handle, const void* request) {
      return zoo_aget(handle, full(path).c_str(), watch ? 1 : 0, &ZooKeeperConnection::on_data, request);
    });
  }

  void children(const std::string& path, bool watch, Done done) override {
    if (watch) {
      done = watching(path, std::move(done), [this, path](Done again) { children(path, true, std::move(again)); });
    }
    start(std::move(done), [&](zhandle_t* handle, const void* request) {
      return zoo_aget_children(handle, full(path).c_str(), watch ? 1 : 0, &ZooKeeperConnection::on_names, request);
    });
  }

 private:
  struct Request {
    ZooKeeperConnection* connection;
    Done done;
  };

  /// Not from a callback of the library: it waits for them. Calls that are under way are answered with `away`, by us:
  /// the library forgets those whose answer its thread has not passed on yet.
  void close() {
    zhandle_t* handle = nullptr;
    {
      const std::unique_lock lock(mutex_);
      handle = std::exchange(handle_, nullptr);
    }
    if (handle != nullptr) zookeeper_close(handle);  // not under the lock: callbacks that run still want it
    std::map<const void*, std::unique_ptr<Request>> forgotten;
    {
      const std::lock_guard lock(requests_mutex_);
      forgotten.swap(requests_);
    }
    for (const auto& [key, request] : forgotten) request->done(with_status(ZCLOSING));
  }

  /// A read of a node that is not there sets no watch: asking whether it exists does. When it came in between, the
  /// read is made again.
  Done watching(const std::string& path, Done done, std::function<void(Done)> read_again) {
    return [this, path, done = std::move(done), read_again = std::move(read_again)](Reply reply) {
      if (reply.status != Status::no_node) {
        done(std::move(reply));
        return;
      }
      Done on_exists = [done, read_again](Reply exists) {
        if (exists.status == Status::ok) {
          read_again(done);
        } else {
          done(std::move(exists));
        }
      };
      start(std::move(on_exists), [&](zhandle_t* handle, const void* request) {
        return zoo_aexists(handle, full(path).c_str(), 1, &ZooKeeperConnection::on_stat, request);
      });
    };
  }

  /// Makes one asynchronous call; `done` is called by the library's thread, or here when it refuses.
  template <typename Call>
  void start(Done done, const Call& call) {
    auto request = std::make_unique<Request>(Request{this, std::move(done)});
    int code = ZINVALIDSTATE;
    {
      const std::shared_lock lock(mutex_);  // close() cannot come in between
      if (handle_ != nullptr) {
        const void* key = request.get();
        remember(std::move(request));
        code = call(handle_, key);
        if (code == ZOK) return;
        request = taken(key);
      }
    }
    request->done(with_status(code));
  }

  void remember(std::unique_ptr<Request> request) {
    const std::lock_guard lock(requests_mutex_);
    const void* key = request.get();
    requests_.emplace(key, std::move(request));
  }

  std::unique_ptr<Request> taken(const void* key) {
    const std::lock_guard lock(requests_mutex_);
    return std::move(requests_.extract(key).mapped());
  }

  static void finish(const void* key, Reply reply) {
    static_cast<const Request*>(key)->connection->taken(key)->done(std::move(reply));
  }

  static void on_created(int code, const char* path, const void* request) {
    Reply reply = with_status(code);
    if (code == ZOK && path != nullptr) reply.path = static_cast<const Request*>(request)->connection->stripped(path);
    finish(request, std::move(reply));
  }
  static void on_stat(int code, const Stat* /*stat*/, const void* request) { finish(request, with_status(code)); }
  static void on_removed(int code, const void* request) { finish(request, with_status(code)); }
  static void on_data(int code, const char* data, int size, const Stat* stat, const void* request) {
    Reply reply = with_status(code);
    if (code == ZOK && stat != nullptr) reply.node = to_node(data, size, *stat);
    finish(request, std::move(reply));
  }
  static void on_names(int code, const String_vector* names, const void* request) {
    Reply reply = with_status(code);
    if (code == ZOK && names != nullptr) {
      reply.names.assign(names->data, names->data + names->count);
      std::sort(reply.names.begin(), reply.names.end());
    }
    finish(request, std::move(reply));
  }
  static void on_chroot(int /*code*/, const char* /*path*/, const void* /*request*/) {}

  static void on_event(zhandle_t* handle, int type, int state, const char* path, void* context) {
    auto& self = *static_cast<ZooKeeperConnection*>(context);
    if (type != ZOO_SESSION_EVENT) {
      if (path != nullptr) self.events_.changed(self.stripped(path));
      return;
    }
    if (state == ZOO_CONNECTED_STATE) {
      self.make_chroot(handle);
      self.events_.connected(zoo_client_id(handle)->client_id, std::chrono::milliseconds(zoo_recv_timeout(handle)));
    } else if (state == ZOO_EXPIRED_SESSION_STATE || state == ZOO_AUTH_FAILED_STATE) {
      self.events_.expired();
    } else {
      self.events_.disconnected();
    }
  }

  /// Under way before any other call of this session, so it takes effect first.
  void make_chroot(zhandle_t* handle) const {
    for (std::size_t end = 1; end < url_.chroot.size();) {
      end = std::min(url_.chroot.find('/', end + 1), url_.chroot.size());
      zoo_acreate(handle, url_.chroot.substr(0, end).c_str(), "", 0, &ZOO_OPEN_ACL_UNSAFE, ZOO_PERSISTENT,
                  &ZooKeeperConnection::on_chroot, nullptr);
    }
  }

  std::string full(const std::string& path) const {
    if (url_.chroot.empty()) return path;
    return path == "/" ? url_.chroot : url_.chroot + path;
  }
  std::string stripped(const std::string& path) const {
    return path.size() == url_.chroot.size() ? "/" : path.substr(url_.chroot.size());
  }

  const Url url_;
  const std::chrono::milliseconds timeout_;
  Events events_;  ///< constant after open()
  std::shared_mutex mutex_;
  zhandle_t* handle_ = nullptr;  ///< guarded by mutex_: shared to call, exclusive to replace
  std::mutex requests_mutex_;
  std::map<const void*, std::unique_ptr<Request>> requests_;  ///< not answered yet; guarded by requests_mutex_
};

}  // namespace

std::unique_ptr<Connection> make_connection(const Url& url, std::chrono::milliseconds session_timeout) {
  return std::make_unique<ZooKeeperConnection>(url, session_timeout);
}

}  // namespace iotcloud::discovery::zookeeper
