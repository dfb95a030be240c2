#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::recorder {

/// Where a running system's registry and brokers are.
struct SystemOptions {
  /// A YAML file with the keys of a topology's file for both (zk.servers, registry.*, brokers), and perhaps others.
  /// Empty: there is none.
  std::string config{};
  std::string registry{};  ///< a URL, in place of the file's. Both empty: ZooKeeper at 127.0.0.1:2181
  /// URLs of logical brokers, in place of the file's and of the channels' records.
  std::vector<std::pair<std::string, std::string>> brokers{};
};

/// The registry and the brokers of a running system, with the credentials of this process's own configuration, which go
/// only to the addresses that it names. Thread safe.
class System {
 public:
  /// \throws config::ConfigError, config::Error.
  explicit System(const SystemOptions& options);

  discovery::Registry& registry() { return *registry_; }
  const discovery::Paths& paths() const { return services_.paths; }
  /// The channel's broker. \throws config::Error when it cannot be used, and in a fleet whose processes have users of
  /// their own for one of which only a record says the address.
  std::shared_ptr<brokers::Broker> broker_of(const discovery::ChannelRecord& channel) const;
  /// \throws config::Error for a record that names no topic.
  static brokers::Topic topic_of(const discovery::ChannelRecord& channel);

 private:
  topology::EndpointServices services_;
  bool users_ = false;
  std::unique_ptr<discovery::Registry> registry_;
};

}  // namespace iotcloud::recorder
