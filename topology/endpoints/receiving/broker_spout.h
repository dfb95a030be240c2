#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <iotcloud/topology/endpoints/placement/spout_placement.h>
#include <iotcloud/topology/endpoints/receiving/dead_letters.h>
#include <iotcloud/topology/endpoints/receiving/inbox.h>
#include <iotcloud/topology/endpoints/receiving/retries.h>
#include <iotcloud/topology/endpoints/receiving/shared_filter.h>
#include <iotcloud/topology/spout.h>

namespace iotcloud::topology {

/// Brings a driver's channel into the topology. With manual acknowledgement (the default) the broker's message is
/// settled when its tuple tree completed; a failed one is tried again from here after a while, and given up after
/// `maxTries`: moved to the dead-letter topic, or rejected without one.
class BrokerSpout final : public Spout {
 public:
  /// \param dead_letters null: what is given up is rejected.
  BrokerSpout(EndpointServicesPtr services, std::shared_ptr<SpoutPlacement> placement,
              std::shared_ptr<DeadLetters> dead_letters, EndpointDefinition endpoint)
      : services_(std::move(services)),
        placement_(std::move(placement)),
        dead_letters_(std::move(dead_letters)),
        endpoint_(std::move(endpoint)) {}

  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare_stream(endpoint_.stream, endpoint_.fields);
  }
  void open(const Config& config, const TopologyContext& context, SpoutOutputCollector& collector) override;
  void close() override;
  bool next_tuple() override;
  void ack(MessageId id) override;
  void fail(MessageId id) override;
  std::chrono::microseconds poll_period() const override;

 private:
  bool bring(Arrival arrival);
  bool is_too_new(const Arrival& arrival);
  void emit(Arrival arrival);
  static bool comes_again(const Arrival& arrival);
  void give_up(Arrival arrival);
  Values values_of(const Arrival& arrival) const;
  MessageId keep(Arrival arrival);
  std::optional<Arrival> take(MessageId id);

  const EndpointServicesPtr services_;
  const std::shared_ptr<SpoutPlacement> placement_;
  const std::shared_ptr<DeadLetters> dead_letters_;
  const EndpointDefinition endpoint_;
  SpoutOutputCollector* collector_ = nullptr;
  std::shared_ptr<Inbox> inbox_;
  SpoutWaker waker_;
  Retries retries_;
  std::optional<SharedFilter> filter_;  ///< with `where`
  std::uint64_t last_sequence_ = 0;
  std::uint64_t fence_count_ = 0;  ///< as an earlier call of next_tuple() saw it
  std::optional<Arrival> next_;    ///< for the next call: it is too new for the one that took it
  config::Counter* received_ = nullptr;
  config::Counter* retried_ = nullptr;
  config::Counter* rejected_ = nullptr;
  std::size_t given_up_silently_ = 0;  ///< since the last line in the log
  std::optional<config::Clock::Instant> last_complaint_;

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
