#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "iotcloud/master/master_types.h"
#include <iotcloud/config/thrift/tls.h>

namespace iotcloud::master::wire {
class TMasterAPIServiceClient;
}

namespace iotcloud::master::cli {

/// No master answered. what() says whom was asked and how to mend it.
class Unreachable : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A master answered that it cannot, or the connection broke when an order was on its way.
class Failed : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Who one is to the masters. Both may be empty.
struct MasterAccess {
  config::TlsFiles tls;
  std::string token;  ///< for authenticate()
};

/// Speaks with the masters of one fleet: asks any that answers, and follows the leader with orders. Used by one thread.
class MasterClient {
 public:
  /// \param addresses "host:port" of some masters. \throws std::invalid_argument for one that is none.
  /// \param election_patience how long an order is offered again while no master leads.
  MasterClient(std::vector<std::string> addresses, MasterAccess access, std::chrono::milliseconds election_patience);
  ~MasterClient();

  /// \throws Unreachable, Failed
  wire::TMasterStatus status();
  std::vector<discovery::wire::TSite> gateways();
  std::vector<discovery::wire::TSensor> drivers();
  std::vector<wire::TTopology> topologies();
  std::vector<wire::TOrder> orders();
  wire::TDriverHistory history(const std::vector<std::string>& instances, const std::vector<std::string>& gateways,
                               std::int32_t most);
  wire::TLogPart read_log(const std::string& gateway, const std::string& instance, const std::string& position,
                          std::int32_t most_bytes);

  /// Gives an order to the master that leads. An order is sent once: when its answer is lost, it is not repeated.
  /// \throws Unreachable, Failed
  wire::TOrderResponse deploy(const wire::TDeployRequest& request);
  wire::TOrderResponse undeploy(const wire::TInstanceSelection& selection);
  wire::TOrderResponse start(const wire::TInstanceSelection& selection);
  wire::TOrderResponse stop(const wire::TInstanceSelection& selection);
  wire::TOrderResponse update_metadata(const wire::TInstanceSelection& selection,
                                       const std::map<std::string, std::string>& changes);
  wire::TOrderResponse change_deployment(const wire::TDeploymentChange& change);
  wire::TOrderResponse drain(const wire::TGatewaySelection& selection);
  wire::TOrderResponse undrain(const wire::TGatewaySelection& selection);
  /// \param steps that the master takes one after the other, each for as long as the request waits, and back again.
  wire::TOrderResponse update(const wire::TUpdateRequest& request, std::size_t steps);
  wire::TTopologyResponse order(const wire::TTopologyRequest& request);

  /// A plugin is offered to the master that leads, and sent to the one that took the offer.
  /// \throws Unreachable, Failed
  wire::TUploadResponse offer_plugin(const wire::TPluginOffer& offer, const std::vector<std::string>& gateways);
  wire::TUploadResponse send_plugin(const std::string& upload, std::int64_t offset, const std::string& bytes);
  wire::TUploadResponse finish_plugin(const std::string& upload);

  /// The master that was spoken with last.
  const std::string& address() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master::cli
