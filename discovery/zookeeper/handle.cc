#include <algorithm>
#include <array>
#include <utility>

#include <iotcloud/discovery/zookeeper/closing.h>
#include <iotcloud/discovery/zookeeper/handle.h>
#include <iotcloud/discovery/zookeeper/logger.h>
#include <iotcloud/discovery/zookeeper/rights.h>

namespace iotcloud::discovery::zookeeper {
namespace {

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
  node.modified_ms = stat.mtime;
  node.ephemeral = stat.ephemeralOwner != 0;
  node.owner_session = stat.ephemeralOwner;
  return node;
}

/// The library's messages are for its maintainers; the registry client logs what users need to know.
void library_log(const char* message) {
  logger.debug("{}", message);
}

}  // namespace

ReplyStatus to_status(int code) {
  switch (code) {
    case ZOK:
      return ReplyStatus::ok;
    case ZNONODE:
      return ReplyStatus::no_node;
    case ZNODEEXISTS:
      return ReplyStatus::exists;
    case ZNOTEMPTY:
      return ReplyStatus::not_empty;
    case ZBADVERSION:
      return ReplyStatus::bad_version;
    case ZNOCHILDRENFOREPHEMERALS:
    case ZBADARGUMENTS:
      return ReplyStatus::bad_path;
    case ZNOAUTH:
    case ZINVALIDACL:
      return ReplyStatus::denied;
    default:
      return ReplyStatus::away;  // the connection or session is lost, or soon will be
  }
}

std::shared_ptr<Handle> Handle::open(const Settings& settings, const RegistryConnection::Events& events) {
  static std::once_flag once;
  std::call_once(once, [] { zoo_set_debug_level(ZOO_LOG_LEVEL_WARN); });
  auto self = std::make_shared<Handle>(settings, events);
  const config::WriteLock lock(self->open_mutex_);  // keeps callbacks from calling the handle before it is stored
  self->handle_ =
      zookeeper_init2(settings.url.hosts.c_str(), &Handle::on_event, static_cast<int>(settings.session_timeout.count()),
                      nullptr, self.get(), ZOO_NO_LOG_CLIENTENV, &library_log);
  if (self->handle_ == nullptr) return nullptr;
  // Without this the library looks up the servers' names whenever its socket is ready, which is a fifth of its work. It
  // still looks them up when a connection is lost.
  zoo_set_servers_resolution_delay(self->handle_, -1);
  return self;
}

void Handle::shut(std::chrono::milliseconds patience) {
  {
    const config::WriteLock lock(callback_mutex_);
    shut_ = true;
  }
  zhandle_t* handle = nullptr;
  {
    const config::WriteLock lock(open_mutex_);
    handle = std::exchange(handle_, nullptr);
  }
  std::vector<Done> unanswered;
  {
    const config::MutexLock lock(requests_mutex_);
    for (const auto& [key, request] : requests_) {
      if (request->done) unanswered.push_back(std::exchange(request->done, nullptr));
    }
  }
  for (const Done& done : unanswered) done(with_status(ZCLOSING));
  if (handle == nullptr) return;
  close_elsewhere([self = shared_from_this(), handle] { zookeeper_close(handle); }, patience);
}

/// Makes one asynchronous call; the library's thread calls `done`, or this thread if the library refuses the call.
template <typename Call>
void Handle::start(Done done, const Call& call) {
  auto request = std::make_unique<Request>(Request{this, std::move(done)});
  Request* const key = request.get();
  int code = ZINVALIDSTATE;
  {
    const config::ReadLock lock(open_mutex_);  // keeps shut() out
    {
      const config::MutexLock requests_lock(requests_mutex_);
      requests_.emplace(key, std::move(request));
    }
    if (handle_ != nullptr) code = call(handle_, key);
    if (code == ZOK) return;
  }
  if (const Done refused = taken(key)) refused(with_status(code));
}

Done Handle::taken(const void* key) {
  const config::MutexLock lock(requests_mutex_);
  const auto node = requests_.extract(key);
  return std::move(node.mapped()->done);
}

void Handle::finish(const void* key, Reply reply) {
  Handle& self = *static_cast<const Request*>(key)->handle;
  const config::ReadLock lock(self.callback_mutex_);
  if (const Done done = self.taken(key)) done(std::move(reply));
}

/// Sends one transaction of two operations: a check that the fence's node exists, and the write.
void Handle::start_fenced(const Fence& fence, const zoo_op_t& write, Done done) {
  const std::string fence_path = full(fence.path);
  std::array<zoo_op_t, 2> both{zoo_op_t{}, write};
  zoo_check_op_init(both.data(), fence_path.c_str(), -1);
  start(std::move(done), [&](zhandle_t* handle, Request* request) {
    return zoo_amulti(handle, static_cast<int>(both.size()), both.data(), request->results.data(), &Handle::on_fenced,
                      request);
  });
}

void Handle::create(const std::string& path, const std::string& data, int mode, const Fence& fence, Done done) {
  const std::string place = full(path);
  const NodeRights rights(settings_, path, settings_.user);
  if (!fence.path.empty()) {
    zoo_op_t write{};
    zoo_create_op_init(&write, place.c_str(), data.data(), static_cast<int>(data.size()), rights.get(), mode, nullptr,
                       0);
    start_fenced(fence, write, std::move(done));
    return;
  }
  start(std::move(done), [&](zhandle_t* handle, const void* request) {
    return zoo_acreate(handle, place.c_str(), data.data(), static_cast<int>(data.size()), rights.get(), mode,
                       &Handle::on_created, request);
  });
}

void Handle::set(const std::string& path, const std::string& data, int expected_version, const Fence& fence,
                 Done done) {
  const std::string place = full(path);
  if (!fence.path.empty()) {
    zoo_op_t write{};
    zoo_set_op_init(&write, place.c_str(), data.data(), static_cast<int>(data.size()), expected_version, nullptr);
    start_fenced(fence, write, std::move(done));
    return;
  }
  start(std::move(done), [&](zhandle_t* handle, const void* request) {
    return zoo_aset(handle, place.c_str(), data.data(), static_cast<int>(data.size()), expected_version,
                    &Handle::on_stat, request);
  });
}

void Handle::remove(const std::string& path, int expected_version, const Fence& fence, Done done) {
  const std::string place = full(path);
  if (!fence.path.empty()) {
    zoo_op_t write{};
    zoo_delete_op_init(&write, place.c_str(), expected_version);
    start_fenced(fence, write, std::move(done));
    return;
  }
  start(std::move(done), [&](zhandle_t* handle, const void* request) {
    return zoo_adelete(handle, place.c_str(), expected_version, &Handle::on_removed, request);
  });
}

void Handle::get(const std::string& path, bool watch, Done done) {
  start(std::move(done), [&](zhandle_t* handle, const void* request) {
    return zoo_aget(handle, full(path).c_str(), watch ? 1 : 0, &Handle::on_data, request);
  });
}

void Handle::children(const std::string& path, bool watch, Done done) {
  start(std::move(done), [&](zhandle_t* handle, const void* request) {
    return zoo_aget_children(handle, full(path).c_str(), watch ? 1 : 0, &Handle::on_names, request);
  });
}

void Handle::exists_watched(const std::string& path, Done done) {
  start(std::move(done), [&](zhandle_t* handle, const void* request) {
    return zoo_aexists(handle, full(path).c_str(), 1, &Handle::on_stat, request);
  });
}

void Handle::on_created(int code, const char* path, const void* request) {
  Reply reply = with_status(code);
  if (code == ZOK && path != nullptr) reply.path = static_cast<const Request*>(request)->handle->stripped(path);
  finish(request, std::move(reply));
}

void Handle::on_stat(int code, const Stat* /*stat*/, const void* request) {
  finish(request, with_status(code));
}

void Handle::on_removed(int code, const void* request) {
  finish(request, with_status(code));
}

void Handle::on_fenced(int code, const void* request) {
  Reply reply = with_status(code);
  // In a failed transaction only the operation that failed has an error that says so.
  if (code == ZNONODE && static_cast<const Request*>(request)->results.front().err == ZNONODE) {
    reply.status = ReplyStatus::fenced;
  }
  finish(request, std::move(reply));
}

void Handle::on_data(int code, const char* data, int size, const Stat* stat, const void* request) {
  Reply reply = with_status(code);
  if (code == ZOK && stat != nullptr) reply.node = to_node(data, size, *stat);
  finish(request, std::move(reply));
}

void Handle::on_names(int code, const String_vector* names, const void* request) {
  Reply reply = with_status(code);
  if (code == ZOK && names != nullptr) {
    reply.names.assign(names->data, names->data + names->count);
    std::sort(reply.names.begin(), reply.names.end());
  }
  finish(request, std::move(reply));
}

void Handle::on_event(zhandle_t* handle, int type, int state, const char* path, void* context) {
  auto& self = *static_cast<Handle*>(context);
  const config::ReadLock lock(self.callback_mutex_);
  if (self.shut_) return;
  if (type != ZOO_SESSION_EVENT) {
    if (path != nullptr) self.events_.changed(self.stripped(path));
    return;
  }
  if (state == ZOO_CONNECTED_STATE) {
    if (!std::exchange(self.identified_, true)) identify(handle, self.settings_);
    self.make_chroot(handle);
    self.events_.connected(zoo_client_id(handle)->client_id, std::chrono::milliseconds(zoo_recv_timeout(handle)));
  } else if (state == ZOO_EXPIRED_SESSION_STATE) {
    self.events_.expired();
  } else if (state == ZOO_AUTH_FAILED_STATE) {
    logger.error("{} refuses the way in which this process says who it is; does it know digest authentication?",
                 self.settings_.url.hosts);
    self.events_.expired();
  } else {
    self.events_.disconnected();
  }
}

/// Creates the nodes of the chroot. These calls are sent before any other call of this session, so they take effect
/// first.
void Handle::make_chroot(zhandle_t* handle) const {
  const std::string& chroot = settings_.url.chroot;
  const NodeRights rights(settings_, "/", settings_.user);
  const auto ignore = [](int /*code*/, const char* /*path*/, const void* /*request*/) {};
  for (std::size_t end = 1; end < chroot.size();) {
    end = std::min(chroot.find('/', end + 1), chroot.size());
    zoo_acreate(handle, chroot.substr(0, end).c_str(), "", 0, rights.get(), ZOO_PERSISTENT, ignore, nullptr);
  }
}

std::string Handle::full(const std::string& path) const {
  const std::string& chroot = settings_.url.chroot;
  if (chroot.empty()) return path;
  return path == "/" ? chroot : chroot + path;
}

std::string Handle::stripped(const std::string& path) const {
  const std::size_t prefix = settings_.url.chroot.size();
  return path.size() == prefix ? "/" : path.substr(prefix);
}

}  // namespace iotcloud::discovery::zookeeper
