#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/topology/endpoints/receiving/known_instances.h>
#include <iotcloud/topology/endpoints/receiving/spout_queue.h>

namespace iotcloud::topology {

/// Decides what becomes of a channel's message by who sent it. The channel says that, not the message: whoever may
/// write to a gateway's channels can put any ids into a message. On an exclusive channel the sender is the channel's
/// instance; on a shared one it is the instance that the message names, if the registry has that one on the channel's
/// gateway, or nobody if the message names none. A message that says otherwise is refused. One whose sender `where`
/// does not choose is accepted, counted and dropped. The others pass, with the true ids of instance and gateway.
///
/// A driver's first message may arrive before the registry has told of the driver: that message and those behind it
/// wait for `grace`, and while the registry is away as long as there is room for those that wait. Belongs to one spout
/// task; not thread safe.
class SenderFilter {
 public:
  /// What became of a message. Neither: it was dropped, or waits.
  struct Passed {
    std::optional<ChannelMessage> arrival;
    std::string refusal{};  ///< why the message must be given up; empty: it may be emitted
  };
  /// \param chooses whether there is a `where` \param metrics gets a counter for each reason for which messages are
  /// refused
  SenderFilter(std::shared_ptr<const KnownInstances> known, bool chooses, config::Metrics& metrics,
               const config::Labels& labels);

  Passed pass(ChannelMessage arrival, config::Clock::Instant now);
  /// \return a message that waited and does so no longer; none: all others still wait.
  Passed next(config::Clock::Instant now);
  /// Whether so many messages of unknown drivers wait that the spout should take no more.
  bool full() const { return waiting_count_ >= most_waiting; }
  bool empty() const { return waiting_count_ == 0; }
  /// Gives the messages that wait back to the broker.
  void clear();

  /// How long a message waits for the registry to tell of its driver. The time does not run while the registry is away.
  /// Nor does it while the registry tells of other drivers for the first time, as when the worker starts, but for
  /// `longest_wait` in all.
  static constexpr std::chrono::seconds grace{2}, longest_wait{30};
  static constexpr std::size_t most_waiting = 1024;  ///< messages, of all drivers
  /// How often the spout should call next() while messages wait.
  static constexpr std::chrono::milliseconds look_again{10};
  /// After a message has waited in vain, those of the same id on the same gateway's channels do not wait for so long: a
  /// driver that is gone for good may have left many.
  static constexpr std::chrono::seconds nobody_for{30};
  static constexpr std::size_t most_nobodies = 10'000;

 private:
  using Instant = config::Clock::Instant;
  /// The id that messages of a shared channel name, and the channel's gateway.
  using Line = std::pair<discovery::InstanceId, discovery::GatewayId>;
  struct Waiting {
    ChannelMessage arrival;
    Instant since;
  };
  Passed judge(ChannelMessage arrival, KnownInstances::Standing standing);
  Passed refuse(ChannelMessage arrival, config::Counter& count, const std::string& why);
  bool is_nobody(const Line& line, Instant now);
  Instant end_of_wait(Instant since) const;
  bool registry_keeps_silent();

  const std::shared_ptr<const KnownInstances> known_;
  const bool chooses_;
  config::Counter& unselected_;
  config::Counter& other_instance_;
  config::Counter& other_gateway_;
  config::Counter& unknown_instance_;
  std::map<Line, std::deque<Waiting>> waiting_;  ///< no queue is empty
  std::size_t waiting_count_ = 0;
  std::map<Line, Instant> nobodies_;     ///< until when messages do not wait
  std::uint64_t news_ = 0;               ///< KnownInstances::news() when it was looked at last
  std::optional<Instant> last_news_;     ///< when it was seen to have grown
  std::optional<Instant> last_silence_;  ///< when the registry was seen to be away
  bool overrun_ = false;  ///< so many messages came since the registry went away that they do not wait for it
};

}  // namespace iotcloud::topology
