#pragma once

#include <memory>
#include <string>
#include <vector>

#include <iotcloud/topology/local/local_cluster.h>

namespace iotcloud::local {

/// The console (master/console/README.md) of a cluster in this process. Whoever may do so without a token, root and
/// this process's user, acts; others see. Thread safe.
class LocalConsole {
 public:
  /// \param cluster outlives the console. \param address of loopback, such as "127.0.0.1:9114"; port 0: any free one
  /// \param pages folders of robots' pages, which need no signature here: whoever runs this process has them on this
  /// machine. \throws config::Error
  LocalConsole(LocalCluster& cluster, const std::string& address, std::vector<std::string> pages = {});
  /// Call it before the cluster's stop().
  ~LocalConsole();
  LocalConsole(const LocalConsole&) = delete;
  LocalConsole& operator=(const LocalConsole&) = delete;

  std::string url() const;  ///< "http://127.0.0.1:9114/"

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::local
