#pragma once

#include <chrono>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/topology/endpoints/receiving/spout_queue.h>

namespace iotcloud::topology {

/// Holds messages whose tuples failed until it is time to emit them again, and the later messages of the same drivers.
/// From a driver's first failure on, its messages are emitted one at a time and in their order, until no failed one is
/// left. Messages of other drivers are not held. (Messages that were under way when the first one failed have overtaken
/// it.) Not thread safe.
class Retries {
 public:
  using Instant = config::Clock::Instant;

  /// How long a message waits after its `tries`-th try failed: 20 ms after the first, doubled with each, 5 s at most.
  static std::chrono::milliseconds pause_after(int tries);

  /// Takes a message whose tuple failed and that is to be emitted again.
  void add(ChannelMessage arrival, Instant now);
  /// Takes a new message if it has to wait behind another one of its driver. \return false: it need not wait, and stays
  /// with the caller.
  bool hold(ChannelMessage& arrival);
  /// The message that is to be emitted now, before any new one; nullopt: none is.
  std::optional<ChannelMessage> next(Instant now);
  /// Says that a message of next() was acked or given up, or that its reader is gone. Ignores other messages.
  void done(const ChannelMessage& arrival);

  bool empty() const { return groups_.empty() && released_.empty(); }
  /// When next() has a message (Instant::min(): now); nullopt: not before done() is called.
  std::optional<Instant> due() const;
  /// Gives everything back to the broker.
  void clear();

 private:
  struct Group {
    std::deque<ChannelMessage> waiting;  ///< in the order in which they came
    std::size_t failed = 0;              ///< number of waiting messages that failed before
    bool under_way = false;              ///< one message of the group is emitted and not done
    std::optional<Instant> planned;      ///< the group's time in agenda_; nullopt: it is not in there
  };
  using Groups = std::map<std::string, Group>;

  static const std::string& driver_of(const ChannelMessage& arrival);
  void insert(Group& group, ChannelMessage arrival);
  void plan(Groups::value_type& entry);
  void unplan(Groups::value_type& entry);

  Groups groups_;  ///< by driver
  /// Groups of which no message is under way, by when their first is due.
  std::set<std::pair<Instant, std::string>> agenda_;
  std::deque<ChannelMessage> released_;  ///< messages that no failed one precedes any more
};

}  // namespace iotcloud::topology
