#pragma once

#include <chrono>
#include <cstddef>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/topology/endpoints/receiving/chosen_instances.h>
#include <iotcloud/topology/endpoints/receiving/spout_queue.h>

namespace iotcloud::topology {

/// Passes on the messages of a shared channel whose sender `where` chooses. It accepts, counts and drops the messages
/// of other instances. A driver's first message may arrive before the registry has told of the driver: that message and
/// those behind it wait for `grace`. Belongs to one spout task; not thread safe.
class SharedFilter {
 public:
  SharedFilter(std::shared_ptr<const ChosenInstances> chosen_instances, config::Counter& dropped)
      : chosen_instances_(std::move(chosen_instances)), dropped_(dropped) {}

  /// \return the message if it may be emitted; nullopt: it was dropped, or waits.
  std::optional<ChannelMessage> pass(ChannelMessage arrival, config::Clock::Instant now);
  /// \return a message that waited and may be emitted now, or nullopt. Drops messages that waited for longer than
  /// `grace`.
  std::optional<ChannelMessage> next(config::Clock::Instant now);
  /// Whether so many messages of unknown drivers wait that the spout should take no more.
  bool full() const { return waiting_count_ >= most_waiting; }
  bool empty() const { return waiting_count_ == 0; }
  /// Gives the messages that wait back to the broker.
  void clear();

  /// How long a message waits for the registry to tell of its driver.
  static constexpr std::chrono::seconds grace{2};
  static constexpr std::size_t most_waiting = 1024;  ///< messages, of all drivers
  /// How often the spout should call next() while messages wait.
  static constexpr std::chrono::milliseconds look_again{10};

 private:
  struct Waiting {
    ChannelMessage arrival;
    config::Clock::Instant since;
  };
  void drop(ChannelMessage& arrival);

  const std::shared_ptr<const ChosenInstances> chosen_instances_;
  config::Counter& dropped_;
  std::map<discovery::InstanceId, std::deque<Waiting>, std::less<>> waiting_;  ///< no queue is empty
  std::size_t waiting_count_ = 0;
};

}  // namespace iotcloud::topology
