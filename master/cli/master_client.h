#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <iotcloud/discovery/channel_look.h>
#include <iotcloud/master/orders/answers.h>
#include <iotcloud/master/topologies/topology_orders.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::master::cli {

/// No master answered. what() names the masters that were asked, and says how to mend it.
class Unreachable : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A master answered that it cannot do what was asked, or the connection broke while an order was on its way.
class RequestFailed : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The credentials that the client shows to masters. Both may be empty.
struct MasterAccess {
  security::TlsFiles tls;
  std::string token;  ///< for authenticate()
};

/// Speaks with the masters of one fleet: asks any that answers, and follows the leader with orders. Used by one thread.
class MasterClient {
 public:
  /// \param addresses "host:port" of some masters. \throws std::invalid_argument for an invalid address, and for one of
  /// another machine if there is a token and no TLS.
  /// \param election_patience how long an order is tried again while no master leads.
  MasterClient(std::vector<std::string> addresses, MasterAccess access, std::chrono::milliseconds election_patience);
  ~MasterClient();

  /// \throws Unreachable, RequestFailed
  MasterStatus status();
  std::vector<discovery::GatewayStatus> gateways();
  std::vector<discovery::DriverRecord> drivers();
  std::vector<discovery::TopologyStatus> topologies();
  std::vector<discovery::PoolRecord> pools();
  std::vector<ListedOrder> orders();
  /// Everything that is ordered, as JSON (orders/backup_file.h).
  std::string backup();
  /// \param instances ids, or how they begin
  DriverHistory history(const std::vector<std::string>& instances, const std::vector<discovery::GatewayId>& gateways,
                        std::int32_t most);
  LogPart read_log(const discovery::GatewayId& gateway, const discovery::InstanceId& instance,
                   const std::string& position, std::int32_t most_bytes);

  /// Looks at a channel of an instance of this gateway, and hands an instance a message. \throws Unreachable,
  /// RequestFailed, also when the answer names a problem
  discovery::ChannelLook look_at_channel(const discovery::GatewayId& gateway, const discovery::LookRequest& request);
  discovery::ChannelLook hand_message(const discovery::GatewayId& gateway, const discovery::HandedMessage& message);
  /// \param gateways empty: all
  GatewayPlugins plugins(const std::vector<discovery::GatewayId>& gateways);

  /// What was ordered for a submitted topology, the oldest first; empty: it is none.
  std::vector<discovery::TopologyEvent> topology_history(const discovery::TopologyName& topology);
  LogPart read_worker_log(const discovery::PlaceId& place, const std::string& position, std::int32_t most_bytes);

  /// A page of a topology's worker, read by a master. \param target "/topology" or "/tap?..."
  std::string worker_page(const discovery::TopologyName& topology, const std::string& worker,
                          const std::string& target);

  /// Gives an order to the master that leads. An order is sent once: when its answer is lost, it is not repeated.
  /// \throws Unreachable, RequestFailed
  OrderResult deploy(const DeployRequest& request);
  OrderResult undeploy(const InstanceSelection& selection);
  OrderResult start(const InstanceSelection& selection);
  OrderResult stop(const InstanceSelection& selection);
  OrderResult update_metadata(const InstanceSelection& selection, const MetadataChanges& changes);
  OrderResult change_deployment(const DeploymentChange& change);
  OrderResult drain(const GatewaySelection& selection);
  OrderResult undrain(const GatewaySelection& selection);
  /// \param steps the number of steps that the master does one after the other. Each may take the request's wait, and
  /// as long again to go back.
  OrderResult update(const UpdateRequest& request, std::size_t steps);
  /// Gives an order that has no method of its own in master.thrift. \param kind its name (orders/order_kinds.h)
  /// \param json its fields. \param steps the number of steps that the master does one after the other, each for up to
  /// `wait`
  OrderResult give(const std::string& kind, const std::string& json, const WaitLimit& wait, std::size_t steps = 1);
  TopologyResult order(const TopologyRequest& request);

  /// A plugin is offered to the master that leads, and sent to the one that took the offer.
  /// \throws Unreachable, RequestFailed
  UploadResult offer_plugin(const PluginOffer& offer, const std::vector<discovery::GatewayId>& gateways);
  /// The same for a component library, to all pools of workers.
  UploadResult offer_library(const PluginOffer& offer);
  UploadResult send_plugin(const std::string& upload, std::int64_t offset, const std::string& bytes);
  UploadResult finish_plugin(const std::string& upload);

  /// The address of the master that this client is or was last connected to.
  const std::string& address() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master::cli
