#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <stdexcept>

#include <zookeeper/zookeeper.h>

#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/tests/discovery/place.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/servers/private_server.h>

namespace iotcloud::discovery::tests {
namespace {

std::string next_name() {
  static std::atomic<int> count{0};
  return "place-" + std::to_string(++count);
}

class EmbeddedPlace : public Place {
 public:
  std::string url() const override { return "embedded://" + name_; }
  void stop() override { server_->stop(); }
  void start() override { server_->start(); }
  void hang() override { server_->stop(); }  // within a process the two are the same
  void go_on() override { server_->start(); }
  void expire(std::int64_t session) override { server_->expire(session); }

 private:
  const std::string name_ = next_name();
  const std::shared_ptr<embedded::RegistryServer> server_ = embedded::RegistryServer::named(name_);
};

/// The password that ZooKeeper gives a session: java.util.Random's bytes, seeded with the session's number and a
/// constant of the server (SessionTrackerImpl, ZooKeeperServer.generatePasswd).
std::array<char, 16> session_password(std::int64_t session) {
  constexpr std::uint64_t mask = (std::uint64_t{1} << 48) - 1;
  constexpr std::uint64_t multiplier = 0x5DEECE66D;
  std::uint64_t state = ((static_cast<std::uint64_t>(session) ^ 0xB3415C00) ^ multiplier) & mask;
  std::array<char, 16> bytes{};
  for (std::size_t i = 0; i < bytes.size(); i += 4) {
    state = (state * multiplier + 0xB) & mask;
    const auto word = static_cast<std::uint32_t>(state >> 16);
    for (std::size_t k = 0; k < 4; ++k) bytes[i + k] = static_cast<char>(word >> (8 * k));
  }
  return bytes;
}

class ZooKeeperPlace : public Place {
 public:
  std::string url() const override { return server().url() + "/" + name_ + "/tree"; }
  void stop() override { server().kill(); }
  void start() override { server().start(); }
  void hang() override { server().pause(); }
  void go_on() override { server().resume(); }

  /// A second client takes the session over and closes it; again, when the first was quick enough to take it back.
  void expire(std::int64_t session) override {
    while (takes_over(session)) {
    }
  }

 private:
  /// \return false when there is no such session any more.
  static bool takes_over(std::int64_t session) {
    struct Seen {
      std::mutex mutex;
      std::condition_variable changed;
      int state = 0;
    } seen;
    clientid_t id{};
    id.client_id = session;
    const auto password = session_password(session);
    std::copy(password.begin(), password.end(), id.passwd);
    const auto on_event = [](zhandle_t* /*handle*/, int type, int state, const char* /*path*/, void* context) {
      if (type != ZOO_SESSION_EVENT || (state != ZOO_CONNECTED_STATE && state != ZOO_EXPIRED_SESSION_STATE)) return;
      auto& told = *static_cast<Seen*>(context);
      const std::lock_guard lock(told.mutex);
      told.state = state;
      told.changed.notify_all();
    };
    const std::string hosts = server().url().substr(std::string("zookeeper://").size());
    zhandle_t* thief = zookeeper_init(hosts.c_str(), on_event, 10000, &id, &seen, 0);
    if (thief == nullptr) throw std::runtime_error("cannot take the session over");
    int state = 0;
    {
      std::unique_lock lock(seen.mutex);
      seen.changed.wait_for(lock, iotcloud::tests::patience, [&] { return seen.state != 0; });
      state = seen.state;
    }
    zookeeper_close(thief);
    if (state == 0) throw std::runtime_error("the server did not answer the second client of a session");
    return state == ZOO_CONNECTED_STATE;
  }

  static iotcloud::tests::PrivateServer& server() {
    static iotcloud::tests::PrivateServer shared("zookeeper.py");
    return shared;
  }
  const std::string name_ = next_name();
};

}  // namespace

std::unique_ptr<Place> make_place(const std::string& kind) {
  if (kind == "embedded") return std::make_unique<EmbeddedPlace>();
  if (kind == "zookeeper") return std::make_unique<ZooKeeperPlace>();
  throw std::invalid_argument(kind);
}

}  // namespace iotcloud::discovery::tests
