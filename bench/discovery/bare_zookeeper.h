#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include <zookeeper/zookeeper.h>

namespace iotcloud::bench {

/// A client on ZooKeeper's C library alone, which starts all given operations at once. It writes the fleet, and is the
/// limit beside which our client is measured. Every failure throws std::runtime_error.
class BareZooKeeper {
 public:
  /// \param url "zookeeper://host:port/chroot"; the chroot must exist or have one name.
  explicit BareZooKeeper(const std::string& url);
  ~BareZooKeeper();
  BareZooKeeper(const BareZooKeeper&) = delete;
  BareZooKeeper& operator=(const BareZooKeeper&) = delete;

  /// Leaves existing nodes unchanged.
  void create(const std::vector<std::pair<std::string, std::string>>& nodes);
  std::vector<std::string> children(const std::string& path);
  /// Reads all nodes, with a watch on each. \return bytes read.
  std::size_t read_and_watch(const std::vector<std::string>& paths);

 private:
  void run(std::size_t count, const std::function<int(std::size_t)>& begin);
  void done(int code, std::size_t bytes);
  static void on_event(zhandle_t* handle, int type, int state, const char* path, void* context);
  static void on_created(int code, const char* path, const void* self);
  static void on_data(int code, const char* data, int size, const Stat* stat, const void* self);

  std::string chroot_;
  zhandle_t* handle_ = nullptr;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool connected_ = false;  ///< guarded by mutex_
  std::size_t under_way_ = 0, bytes_ = 0;
  int failure_ = ZOK;
};

/// A server's own counters since it began, which no other work on the machine changes.
struct ServerCounts {
  std::int64_t requests = 0;  ///< received, pings included
  std::int64_t writes = 0;    ///< put on disk, refused ones included
};
/// \param url of a single server. \throws std::runtime_error.
ServerCounts counts_of(const std::string& url);

}  // namespace iotcloud::bench
