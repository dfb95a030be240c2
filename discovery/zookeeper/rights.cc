#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <optional>
#include <set>
#include <string_view>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/zookeeper/logger.h>
#include <iotcloud/discovery/zookeeper/rights.h>

namespace iotcloud::discovery::zookeeper {

namespace {

constexpr std::size_t progress_step = 1000;  ///< nodes

/// A session for one piece of work that waits for each answer.
class RightsSession {
 public:
  /// \param settings must outlive this object
  RightsSession(const Settings& settings, std::chrono::milliseconds limit) : settings_(settings) {
    handle_ = zookeeper_init2(settings.url.hosts.c_str(), &RightsSession::on_event,
                              static_cast<int>(settings.session_timeout.count()), nullptr, this, ZOO_NO_LOG_CLIENTENV,
                              [](const char* message) { logger.debug("{}", message); });
    if (handle_ == nullptr)
      throw config::Error(fmt::format("the registry {} cannot be used: {}", settings.url.hosts, std::strerror(errno)));
    if (connected_within(limit)) return;
    zookeeper_close(handle_);
    throw config::Error(fmt::format("the registry {} does not answer within {} s: is its server running?",
                                    settings.url.hosts, limit.count() / 1000));
  }
  ~RightsSession() { zookeeper_close(handle_); }
  RightsSession(const RightsSession&) = delete;
  RightsSession& operator=(const RightsSession&) = delete;

  zhandle_t* get() const { return handle_; }

 private:
  bool connected_within(std::chrono::milliseconds limit) {
    const config::MutexLock lock(mutex_);
    return changed_.wait_for(mutex_, limit, [this]() IOTCLOUD_REQUIRES(mutex_) { return connected_; });
  }
  static void on_event(zhandle_t* handle, int type, int state, const char* /*path*/, void* self) {
    if (type != ZOO_SESSION_EVENT || state != ZOO_CONNECTED_STATE) return;
    auto* const session = static_cast<RightsSession*>(self);
    const config::MutexLock lock(session->mutex_);
    if (!std::exchange(session->connected_, true)) identify(handle, session->settings_);
    session->changed_.notify_all();
  }

  const Settings& settings_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  bool connected_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  zhandle_t* handle_ = nullptr;
};

/// The walk over the nodes.
class RightsRenewal {
 public:
  RightsRenewal(const Settings& settings, const Paths& paths, std::chrono::milliseconds limit,
                const std::function<void(std::size_t)>& progress, ServersNodes servers)
      : settings_(settings), paths_(paths), progress_(progress), servers_(servers), session_(settings, limit) {}

  RenewedRights run() {
    const std::string& chroot = settings_.url.chroot;
    for (std::size_t end = 1; end < chroot.size();) {
      end = std::min(chroot.find('/', end + 1), chroot.size());
      if (!renew(chroot.substr(0, end), "/", "")) make(chroot.substr(0, end), "/");
    }
    for (std::size_t end = paths_.sensors.find('/', 1); end != std::string::npos;
         end = paths_.sensors.find('/', end + 1)) {
      const std::string above = paths_.sensors.substr(0, end);
      if (!renew(chroot + above, above, "")) make(chroot + above, above);
    }
    for (const std::string& branch : paths_.branches()) {
      walk(branch, "");
      make(chroot + branch, branch);
    }
    must_be_its_own(chroot + paths_.gateways);
    look_at_servers_node("/");
    look_at_servers_node("/zookeeper");
    look_below("/zookeeper/quota");
    return done_;
  }

 private:
  /// Makes a node at or above a branch if it is missing, before a process does that is no master.
  void make(const std::string& full, const std::string& path) {
    const NodeRights rights(settings_, path, "");
    const int code = zoo_create(session_.get(), full.c_str(), "", 0, rights.get(), 0, nullptr, 0);
    if (code != ZNODEEXISTS) must(code, full);
  }

  void walk(const std::string& path, const std::string& creator_above) {
    const std::string full = settings_.url.chroot + path;
    const auto creator = renew(full, path, creator_above);
    if (!creator) return;
    String_vector names{};
    const int code = zoo_get_children(session_.get(), full.c_str(), 0, &names);
    if (code == ZNONODE) return;
    must(code, full);
    const std::unique_ptr<String_vector, void (*)(String_vector*)> owner(
        &names, [](String_vector* list) { deallocate_String_vector(list); });
    for (int i = 0; i < names.count; ++i) walk(path + "/" + names.data[i], *creator);
  }

  /// Closing a node that everybody may change needs no right, so a wrong password would shut its user out: this tells.
  void must_be_its_own(const std::string& branch) {
    String_vector names{};
    must(zoo_get_children(session_.get(), branch.c_str(), 0, &names), branch);
    deallocate_String_vector(&names);
  }

  void look_below(const std::string& path) {
    if (!look_at_servers_node(path)) return;
    String_vector names{};
    if (zoo_get_children(session_.get(), path.c_str(), 0, &names) != ZOK) return;
    const std::unique_ptr<String_vector, void (*)(String_vector*)> owner(
        &names, [](String_vector* list) { deallocate_String_vector(list); });
    for (int i = 0; i < names.count; ++i) look_below(path + "/" + names.data[i]);
  }

  /// Closes a node of the server's own, or notes that it is open, or not this master's. \return whether this master may
  /// look further
  bool look_at_servers_node(const std::string& full) {
    const NodeRights now(settings_, full, "");
    for (;;) {
      ACL_vector before{};
      Stat stat{};
      const int code = zoo_get_acl(session_.get(), full.c_str(), &before, &stat);
      if (code == ZNONODE) return false;
      if (code == ZNOAUTH) {
        done_.seized.push_back(full);
        return false;
      }
      must(code, full);
      const std::unique_ptr<ACL_vector, void (*)(ACL_vector*)> owner(
          &before, [](ACL_vector* list) { deallocate_ACL_vector(list); });
      ++done_.nodes;
      if (now.are(before)) return true;
      if (servers_ == ServersNodes::only_looked_at) {
        if (may_everybody_change(before)) done_.open.push_back(full);
        return true;
      }
      const int changed = zoo_set_acl(session_.get(), full.c_str(), stat.aversion, now.get());
      if (changed == ZBADVERSION) continue;
      if (changed == ZNONODE) return false;
      if (changed == ZNOAUTH) {
        done_.seized.push_back(full);
        return true;
      }
      must(changed, full);
      ++done_.changed;
      return true;
    }
  }

  static bool may_everybody_change(const ACL_vector& rights) {
    return std::any_of(rights.data, rights.data + rights.count, [](const ACL& right) {
      return std::string_view(right.id.scheme) == "world" && (right.perms & ~ZOO_PERM_READ) != 0;
    });
  }

  /// Sets the rights of one node. \return whose it is; nullopt: it is not there
  std::optional<std::string> renew(const std::string& full, const std::string& path, const std::string& creator_above) {
    for (;;) {
      ACL_vector before{};
      Stat stat{};
      const int code = zoo_get_acl(session_.get(), full.c_str(), &before, &stat);
      if (code == ZNONODE || (code == ZNOAUTH && take_away(full, path))) return std::nullopt;
      must(code, full);
      const std::unique_ptr<ACL_vector, void (*)(ACL_vector*)> owner(
          &before, [](ACL_vector* list) { deallocate_ACL_vector(list); });
      const std::string creator = creator_of(full, path, before, creator_above);
      const NodeRights now(settings_, path, creator);
      if (!now.are(before)) {
        const int changed = zoo_set_acl(session_.get(), full.c_str(), stat.aversion, now.get());
        if (changed == ZNONODE || (changed == ZNOAUTH && take_away(full, path))) return std::nullopt;
        if (changed == ZBADVERSION) continue;
        must(changed, full);
        ++done_.changed;
      }
      if (++done_.nodes % progress_step == 0 && progress_) progress_(done_.nodes);
      return creator;
    }
  }

  /// Removes a branch, or a node below one, that keeps masters out, or notes that it cannot be. \return false: it is
  /// above the branches, so this user is none that the fleet knows
  bool take_away(const std::string& full, const std::string& path) {
    const auto branches = paths_.branches();
    if (std::none_of(branches.begin(), branches.end(),
                     [&](const auto& branch) { return path == branch || path.starts_with(branch + "/"); }))
      return false;
    const int code = zoo_delete(session_.get(), full.c_str(), -1);
    if (code == ZOK) {
      done_.removed.push_back(path);
    } else if (code == ZNOTEMPTY) {
      done_.foreign.push_back(path);
    } else if (code != ZNONODE) {
      must(code, full);
    }
    return true;
  }

  /// The gateway that has an instance's records: that of the node above, that which has all rights on it until now, or
  /// that which the instance's record names. Other nodes have no creator that matters.
  std::string creator_of(const std::string& full, const std::string& path, const ACL_vector& before,
                         const std::string& creator_above) const {
    if (!path.starts_with(paths_.sensors + "/") || !creator_above.empty()) return creator_above;
    if (std::count(path.begin(), path.end(), '/') != std::count(paths_.sensors.begin(), paths_.sensors.end(), '/') + 2)
      return "";
    std::string data(std::size_t{1} << 20, '\0');
    int size = static_cast<int>(data.size());
    Stat stat{};
    if (zoo_get(session_.get(), full.c_str(), 0, data.data(), &size, &stat) == ZOK && size > 0) {
      data.resize(static_cast<std::size_t>(size));
      try {
        std::string gateway = decode_driver(data, path).gateway.str();
        if (settings_.access->knows(gateway)) return gateway;
      } catch (const config::Error&) {  // no record yet, or not ours: who has the rights tells
      }
    }
    for (int i = 0; i < before.count; ++i) {
      const ACL& right = before.data[i];
      std::string user = std::string(right.id.id).substr(0, std::string(right.id.id).find(':'));
      if (right.perms == ZOO_PERM_ALL && settings_.access->is_gateway(user)) return user;
    }
    return "";
  }

  static void must(int code, const std::string& path) {
    if (code == ZOK) return;
    if (code == ZNOAUTH) {
      throw config::Error(
          fmt::format("{} does not let this user change its rights: give a master's user and password, "
                      "one that the node's list has now. If somebody else made it before a master came, ZooKeeper's "
                      "superuser has to remove it (deleteall {})",
                      path, path));
    }
    throw config::Error(
        fmt::format("the rights of {} cannot be renewed: {}; run it again, what is done stays", path, zerror(code)));
  }

  const Settings& settings_;
  const Paths& paths_;
  const std::function<void(std::size_t)>& progress_;
  const ServersNodes servers_;
  RightsSession session_;
  RenewedRights done_;
};

}  // namespace

void identify(zhandle_t* handle, const Settings& settings) {
  const std::string& identity = settings.identity;
  if (identity.empty()) return;
  const int code = zoo_add_auth(handle, "digest", identity.data(), static_cast<int>(identity.size()), nullptr, nullptr);
  if (code != ZOK) logger.error("{}: this process cannot say who it is: {}", settings.url.hosts, zerror(code));
}

NodeRights::NodeRights(const Settings& settings, const std::string& path, const std::string& creator) {
  static char auth[] = "auth", world[] = "world", anyone[] = "anyone", nothing[] = "", digest[] = "digest";
  if (settings.identity.empty()) return;
  if (settings.access) {
    grants_ = settings.access->grants(path, creator);
    for (auto& grant : grants_) rights_.push_back(ACL{grant.rights, ::Id{digest, grant.id.data()}});
  }
  if (rights_.empty()) rights_.push_back(ACL{ZOO_PERM_ALL, ::Id{auth, nothing}});
  if (settings.others_may_read) rights_.push_back(ACL{ZOO_PERM_READ, ::Id{world, anyone}});
  list_ = {static_cast<int>(rights_.size()), rights_.data()};
}

bool NodeRights::are(const ACL_vector& of_node) const {
  const auto all = [](const ACL_vector& list) {
    std::multiset<std::pair<std::string, int>> rights;
    for (int i = 0; i < list.count; ++i) {
      rights.emplace(std::string(list.data[i].id.scheme) + ":" + list.data[i].id.id, list.data[i].perms);
    }
    return rights;
  };
  return all(*get()) == all(of_node);
}

RenewedRights renew_rights(const Settings& settings, const Paths& paths, std::chrono::milliseconds limit,
                           const std::function<void(std::size_t)>& progress, ServersNodes servers) {
  return RightsRenewal(settings, paths, limit, progress, servers).run();
}

}  // namespace iotcloud::discovery::zookeeper
