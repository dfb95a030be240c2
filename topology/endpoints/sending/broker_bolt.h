#pragma once

#include <memory>

#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/endpoints/sending/route_table.h>

namespace iotcloud::topology {

/// A bolt that sends tuples to a driver's channel: each to the driver instance that its field driverID names, with the
/// time of its field `time` and the properties of the fields that YAML names as such (null: without that property).
/// ChannelSender says when a tuple is acked.
class BrokerBolt final : public Bolt {
 public:
  BrokerBolt(EndpointServicesPtr services, std::shared_ptr<RouteTable> routes, EndpointDefinition endpoint)
      : services_(std::move(services)),
        routes_(std::move(routes)),
        endpoint_(std::move(endpoint)),
        payload_fields_(payload_fields(endpoint_)) {}

  void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) override;
  void execute(const Tuple& tuple) override;
  void cleanup() override;

 private:
  const EndpointServicesPtr services_;
  const std::shared_ptr<RouteTable> routes_;
  const EndpointDefinition endpoint_;
  const Fields payload_fields_;
  std::unique_ptr<MessageBuilder> builder_;  ///< null for the forms `bytes` and `text`
  OutputCollector* collector_ = nullptr;
  bool first_task_ = false;
};

}  // namespace iotcloud::topology
