#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/topology/endpoints/receiving/dead_letter_sender.h>
#include <iotcloud/topology/endpoints/receiving/retries.h>
#include <iotcloud/topology/endpoints/receiving/sender_filter.h>
#include <iotcloud/topology/endpoints/receiving/spout_placement.h>
#include <iotcloud/topology/endpoints/receiving/spout_queue.h>
#include <iotcloud/topology/spout.h>

namespace iotcloud::topology {

/// A spout that emits the messages of a driver's channel. With manual acknowledgement (the default) it settles a
/// message when its tuple tree is done. A message whose tuple failed is emitted again after a pause, and given up after
/// `maxTries` tries: it is moved to the dead-letter topic, or rejected if there is none. Tries for whose failure a bolt
/// does not blame the message (OutputCollector::retry()) do not count.
class BrokerSpout final : public Spout {
 public:
  /// \param dead_letters null: messages that are given up are rejected.
  BrokerSpout(EndpointServicesPtr services, std::shared_ptr<SpoutPlacement> placement,
              std::shared_ptr<DeadLetterSender> dead_letters, EndpointDefinition endpoint)
      : services_(std::move(services)),
        placement_(std::move(placement)),
        dead_letters_(std::move(dead_letters)),
        endpoint_(std::move(endpoint)),
        payload_fields_(payload_fields(endpoint_)),
        arrivals_(placement_->arrivals()) {}

  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare_stream(endpoint_.stream, endpoint_.fields);
  }
  void open(const Config& config, const TopologyContext& context, SpoutOutputCollector& collector) override;
  void close() override;
  bool next_tuple() override;
  void ack(MessageId id) override;
  void fail(MessageId id) override;
  void retry(MessageId id) override;
  std::chrono::microseconds poll_period() const override;

 private:
  void note_arrival(const ChannelMessage& arrival);
  bool bring(ChannelMessage arrival);
  bool is_first_after_fence(const ChannelMessage& arrival);
  void emit(ChannelMessage arrival);
  void try_again(ChannelMessage arrival);
  static bool comes_again(const ChannelMessage& arrival);
  /// What the log is told of messages that are given up: one line for many.
  struct Complaints {
    std::size_t untold = 0;                      ///< messages since the last line
    std::optional<config::Clock::Instant> last;  ///< when the log got a line
  };
  bool admit(SenderFilter::Passed passed);
  void refuse(ChannelMessage arrival, const std::string& reason);
  void give_up(ChannelMessage arrival, const std::string& reason);
  bool may_say(Complaints& complaints) const;
  std::string fate() const;
  static std::string others(Complaints& complaints);
  void turn_away(ChannelMessage arrival, const std::string& reason);
  Values values_of(const ChannelMessage& arrival) const;
  MessageId keep(ChannelMessage arrival);
  std::optional<ChannelMessage> take(MessageId id);
  std::shared_ptr<MessageTrace> trace_of(const ChannelMessage& arrival);
  void end_trace(MessageId id, const char* outcome);

  const EndpointServicesPtr services_;
  const std::shared_ptr<SpoutPlacement> placement_;
  const std::shared_ptr<DeadLetterSender> dead_letters_;
  const EndpointDefinition endpoint_;
  const Fields payload_fields_;
  const std::shared_ptr<Arrivals> arrivals_;
  std::unique_ptr<MessageBuilder> builder_;  ///< null for the forms `bytes` and `text`
  SpoutOutputCollector* collector_ = nullptr;
  std::string component_;                                      ///< set by open()
  std::map<MessageId, std::shared_ptr<MessageTrace>> traced_;  ///< of messages under way that are followed
  std::shared_ptr<SpoutQueue> queue_;
  SpoutWaker waker_;
  Retries retries_;
  std::optional<SenderFilter> filter_;  ///< set by open()
  std::uint64_t last_sequence_ = 0;
  std::uint64_t fence_count_ = 0;  ///< TopicReader::fence_count() of the message before; see is_first_after_fence()
  std::optional<ChannelMessage> next_;  ///< left to the next call of next_tuple(), see is_first_after_fence()
  config::Counter* received_ = nullptr;
  config::Counter* retried_ = nullptr;
  config::Counter* rejected_ = nullptr;
  config::Counter* unreadable_ = nullptr;
  Complaints given_up_, refused_;

  /// Holds a message that is under way. A message id is the slot's index and how often the slot was used, so that a
  /// late ack or fail does not hit the slot's next message.
  struct Slot {
    std::optional<ChannelMessage> arrival;
    std::uint32_t uses = 0;
  };
  std::vector<Slot> slots_;
  std::vector<std::uint32_t> free_;
};

}  // namespace iotcloud::topology
