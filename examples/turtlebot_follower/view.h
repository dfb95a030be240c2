#pragma once

#include <memory>
#include <string>
#include <vector>

#include <iotcloud/topology/local/local_cluster.h>

/// The page that shows the demo while it runs.
class View {
 public:
  virtual ~View() = default;
  virtual std::string url() const = 0;
};

/// \param address of loopback; port 0: a free one. \param pages folders of robots' pages. \throws
/// iotcloud::config::Error, always in the program that has no page (no_view.cc), because newcomers compile it first and
/// a page is half a minute of compiling.
std::unique_ptr<View> show(iotcloud::local::LocalCluster& cluster, const std::string& address,
                           const std::vector<std::string>& pages);
