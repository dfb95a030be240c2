#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/security/trusted_keys.h>
#include <iotcloud/topology/pool/place_shares.h>

namespace iotcloud::topology {

/// Watches in the registry what is submitted, which pools live, and who holds which place. With the keys of masters it
/// follows only submissions that one of them has signed for this topology, and none that was given before the last one,
/// or long before it was written. One that is refused, or vanishes, changes nothing: what was submitted before still
/// holds. Thread safe.
class PoolWatch {
 public:
  struct Options {
    discovery::Registry* registry = nullptr;  ///< not null; outlives the watch
    discovery::Paths paths;
    std::shared_ptr<const security::TrustedKeys> masters;  ///< null: submissions need no signature
    /// Called with what is seen, soon and after each change, on the registry's dispatcher.
    std::function<void(PoolView view, std::string trouble)> on_view;
  };
  explicit PoolWatch(Options options);
  ~PoolWatch();

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;
  std::jthread keys_watch_;  ///< TrustedKeys::on_change(); last, because it uses the other member
};

}  // namespace iotcloud::topology
