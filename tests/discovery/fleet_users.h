#pragma once

#include <atomic>
#include <stdexcept>
#include <string>
#include <vector>

#include <zookeeper/zookeeper.h>

#include <iotcloud/discovery/access.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::discovery::tests {

inline std::string fleet_password(const std::string& user) {
  return "secret of " + user;
}

/// A fleet whose users have rights of their own: master, gateways g1 and g2, worker.
inline std::vector<RegistryUser> fleet_users() {
  using Role = RegistryUser::Role;
  // base64 of SHA-1 of "USER:PASSWORD"
  return {{Role::master, "masters", "OMsZ4EHB4vTTDlYF30hOD4UN9Gs="},
          {Role::gateway, "g1", "0uEjd9Pgjl8v3nhquvFg8rgopuU="},
          {Role::gateway, "g2", "nnalarx0gGsG9ajZ9zmK5cdN9cc="},
          {Role::worker, "workers", "D70c15/9OcCuC92fenWl5kJD72g="}};
}

/// ZooKeeper's own client, as a thief uses it: with rights of its choice on what it makes.
class BareClient {
 public:
  /// \param user of fleet_users(); empty: a client without a credential, as a driver host is
  BareClient(const std::string& url, const std::string& user)
      : identity_(user.empty() ? "" : user + ":" + fleet_password(user)) {
    zoo_set_debug_level(ZOO_LOG_LEVEL_ERROR);
    handle_ = zookeeper_init(url.substr(url.find("//") + 2).c_str(), &BareClient::on_event, 20'000, nullptr, this, 0);
    if (handle_ == nullptr || !iotcloud::tests::eventually([this] { return ready_.load(); }))
      throw std::runtime_error("no connection to " + url);
  }
  ~BareClient() { zookeeper_close(handle_); }
  BareClient(const BareClient&) = delete;
  BareClient& operator=(const BareClient&) = delete;

  /// Makes a node that nobody else may use, if this client has a credential.
  int create(const std::string& path, const std::string& data = "mine") {
    return zoo_create(handle_, path.c_str(), data.data(), static_cast<int>(data.size()), own(), 0, nullptr, 0);
  }
  /// Makes a node that everybody may use its own.
  int seize(const std::string& path) { return zoo_set_acl(handle_, path.c_str(), -1, own()); }
  int set(const std::string& path, const std::string& data) {
    return zoo_set(handle_, path.c_str(), data.data(), static_cast<int>(data.size()), -1);
  }
  int remove(const std::string& path) { return zoo_delete(handle_, path.c_str(), -1); }
  int exists(const std::string& path) { return zoo_exists(handle_, path.c_str(), 0, nullptr); }
  int children(const std::string& path) {
    String_vector names{};
    const int code = zoo_get_children(handle_, path.c_str(), 0, &names);
    if (code == ZOK) deallocate_String_vector(&names);
    return code;
  }
  int get(const std::string& path) {
    int size = 0;
    return zoo_get(handle_, path.c_str(), 0, nullptr, &size, nullptr);
  }

 private:
  const ACL_vector* own() const { return identity_.empty() ? &ZOO_OPEN_ACL_UNSAFE : &ZOO_CREATOR_ALL_ACL; }
  static void on_event(zhandle_t* handle, int type, int state, const char* /*path*/, void* self) {
    auto* const client = static_cast<BareClient*>(self);
    if (type != ZOO_SESSION_EVENT || state != ZOO_CONNECTED_STATE || client->ready_) return;
    const std::string& identity = client->identity_;
    if (!identity.empty())
      zoo_add_auth(handle, "digest", identity.data(), static_cast<int>(identity.size()), nullptr, nullptr);
    client->ready_ = true;
  }

  const std::string identity_;
  std::atomic<bool> ready_{false};
  zhandle_t* handle_ = nullptr;
};

}  // namespace iotcloud::discovery::tests
