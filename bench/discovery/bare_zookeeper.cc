#include <array>
#include <chrono>
#include <stdexcept>

#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/bench/discovery/bare_zookeeper.h>

namespace iotcloud::bench {

namespace {

constexpr std::size_t most_under_way = 1000;

}  // namespace

BareZooKeeper::BareZooKeeper(const std::string& url) {
  const std::string rest = url.substr(std::string("zookeeper://").size());
  const auto slash = rest.find('/');
  if (slash != std::string::npos) chroot_ = rest.substr(slash);
  zoo_set_debug_level(ZOO_LOG_LEVEL_ERROR);
  handle_ = zookeeper_init(rest.substr(0, slash).c_str(), &BareZooKeeper::on_event, 30'000, nullptr, this, 0);
  if (handle_ == nullptr) throw std::runtime_error("cannot connect to " + url);
  std::unique_lock lock(mutex_);
  if (!changed_.wait_for(lock, std::chrono::seconds(30), [this] { return connected_; })) {
    throw std::runtime_error("no answer from " + url);
  }
  lock.unlock();
  if (!chroot_.empty()) zoo_create(handle_, chroot_.c_str(), "", 0, &ZOO_OPEN_ACL_UNSAFE, 0, nullptr, 0);
}

BareZooKeeper::~BareZooKeeper() {
  if (handle_ != nullptr) zookeeper_close(handle_);
}

void BareZooKeeper::on_event(zhandle_t* /*handle*/, int type, int state, const char* /*path*/, void* context) {
  auto& self = *static_cast<BareZooKeeper*>(context);
  if (type != ZOO_SESSION_EVENT || state != ZOO_CONNECTED_STATE) return;
  const std::lock_guard lock(self.mutex_);
  self.connected_ = true;
  self.changed_.notify_all();
}

/// Starts `count` operations, as many at a time as a server takes, and waits for all.
void BareZooKeeper::run(std::size_t count, const std::function<int(std::size_t)>& begin) {
  std::unique_lock lock(mutex_);
  for (std::size_t i = 0; i < count; ++i) {
    changed_.wait(lock, [this] { return under_way_ < most_under_way; });
    ++under_way_;
    lock.unlock();
    const int code = begin(i);
    if (code != ZOK) done(code, 0);
    lock.lock();
  }
  changed_.wait(lock, [this] { return under_way_ == 0; });
  if (failure_ != ZOK) throw std::runtime_error(std::string("ZooKeeper: ") + zerror(failure_));
}

void BareZooKeeper::done(int code, std::size_t bytes) {
  const std::lock_guard lock(mutex_);
  --under_way_;
  bytes_ += bytes;
  if (code != ZOK && code != ZNODEEXISTS) failure_ = code;
  if (under_way_ == 0 || under_way_ == most_under_way - 1) changed_.notify_all();
}

void BareZooKeeper::on_created(int code, const char* /*path*/, const void* self) {
  static_cast<BareZooKeeper*>(const_cast<void*>(self))->done(code, 0);
}

void BareZooKeeper::on_data(int code, const char* /*data*/, int size, const Stat* /*stat*/, const void* self) {
  static_cast<BareZooKeeper*>(const_cast<void*>(self))->done(code, size > 0 ? static_cast<std::size_t>(size) : 0);
}

void BareZooKeeper::create(const std::vector<std::pair<std::string, std::string>>& nodes) {
  run(nodes.size(), [&](std::size_t i) {
    const auto& [path, data] = nodes[i];
    return zoo_acreate(handle_, (chroot_ + path).c_str(), data.data(), static_cast<int>(data.size()),
                       &ZOO_OPEN_ACL_UNSAFE, 0, &BareZooKeeper::on_created, this);
  });
}

std::vector<std::string> BareZooKeeper::children(const std::string& path) {
  String_vector names{};
  const int code = zoo_get_children(handle_, (chroot_ + path).c_str(), 1, &names);
  if (code != ZOK) throw std::runtime_error(path + ": " + zerror(code));
  std::vector<std::string> all(names.data, names.data + names.count);
  deallocate_String_vector(&names);
  return all;
}

std::size_t BareZooKeeper::read_and_watch(const std::vector<std::string>& paths) {
  bytes_ = 0;
  run(paths.size(),
      [&](std::size_t i) { return zoo_aget(handle_, (chroot_ + paths[i]).c_str(), 1, &BareZooKeeper::on_data, this); });
  return bytes_;
}

namespace {

/// The answer to one of the server's four-letter words.
std::string ask(const std::string& host, const std::string& port, const std::string& word) {
  addrinfo* found = nullptr;
  addrinfo wanted{};
  wanted.ai_socktype = SOCK_STREAM;
  if (::getaddrinfo(host.c_str(), port.c_str(), &wanted, &found) != 0) throw std::runtime_error("no host " + host);
  const int connection = ::socket(found->ai_family, found->ai_socktype, 0);
  const bool connected = connection >= 0 && ::connect(connection, found->ai_addr, found->ai_addrlen) == 0;
  ::freeaddrinfo(found);
  std::string answer;
  if (connected && ::send(connection, word.data(), word.size(), MSG_NOSIGNAL) > 0) {
    std::array<char, 4096> part{};
    for (ssize_t size; (size = ::recv(connection, part.data(), part.size(), 0)) > 0;) {
      answer.append(part.data(), static_cast<std::size_t>(size));
    }
  }
  if (connection >= 0) ::close(connection);
  return answer;
}

std::int64_t number_after(const std::string& text, const std::string& title) {
  const auto place = text.find(title);
  if (place == std::string::npos) throw std::runtime_error("ZooKeeper does not say: " + title);
  return std::stoll(text.substr(place + title.size()), nullptr, 0);
}

}  // namespace

ServerCounts counts_of(const std::string& url) {
  const std::string rest = url.substr(std::string("zookeeper://").size());
  const std::string address = rest.substr(0, rest.find('/'));
  const auto colon = address.rfind(':');
  const std::string answer = ask(address.substr(0, colon), address.substr(colon + 1), "srvr");
  return {number_after(answer, "Received: "), number_after(answer, "Zxid: ")};
}

}  // namespace iotcloud::bench
