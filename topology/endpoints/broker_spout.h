#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <iotcloud/topology/endpoints/inbox.h>
#include <iotcloud/topology/endpoints/spout_placement.h>
#include <iotcloud/topology/spout.h>

namespace iotcloud::topology {

/// Brings a driver's channel into the topology. With manual acknowledgement (the default) the broker's message is
/// settled when its tuple tree completed; a failed one is tried again from here, before what waits, and rejected after
/// `maxTries`.
class BrokerSpout final : public Spout {
 public:
  BrokerSpout(EndpointServicesPtr services, std::shared_ptr<SpoutPlacement> placement, EndpointDefinition endpoint)
      : services_(std::move(services)), placement_(std::move(placement)), endpoint_(std::move(endpoint)) {}

  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare_stream(endpoint_.stream, endpoint_.fields);
  }
  void open(const Config& config, const TopologyContext& context, SpoutOutputCollector& collector) override;
  void close() override;
  bool next_tuple() override;
  void ack(MessageId id) override;
  void fail(MessageId id) override;

 private:
  Values values_of(const Arrival& arrival) const;
  MessageId keep(Arrival arrival);
  std::optional<Arrival> take(MessageId id);

  const EndpointServicesPtr services_;
  const std::shared_ptr<SpoutPlacement> placement_;
  const EndpointDefinition endpoint_;
  SpoutOutputCollector* collector_ = nullptr;
  std::shared_ptr<Inbox> inbox_;
  config::Counter* received_ = nullptr;
  config::Counter* retried_ = nullptr;
  config::Counter* rejected_ = nullptr;

  /// What is under way, by slot. A message id is the slot and how often the slot was used, so that a late answer finds
  /// nothing.
  struct Slot {
    std::optional<Arrival> arrival;
    std::uint32_t uses = 0;
  };
  std::vector<Slot> slots_;
  std::vector<std::uint32_t> free_;
};

}  // namespace iotcloud::topology
