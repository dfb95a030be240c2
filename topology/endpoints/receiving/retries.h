#pragma once

#include <chrono>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/topology/endpoints/receiving/inbox.h>

namespace iotcloud::topology {

/// Messages whose tuples failed, until it is time to try them again, and what came behind them from the same driver: a
/// driver's messages are tried one after the other, in their order, until none of them has failed; other drivers' go
/// on. (What was under way already when the first one failed has overtaken it.) Not thread safe.
class Retries {
 public:
  using Instant = config::Clock::Instant;

  /// How long a message waits after so many tries: 20 ms, doubled with each, 5 s at most.
  static std::chrono::milliseconds pause_after(int tries);

  /// Takes a message that failed and is to be tried again.
  void add(Arrival arrival, Instant now);
  /// Takes a new message when it has to wait behind another one of its driver. \return false: it has not.
  bool hold(Arrival& arrival);
  /// What is to be emitted now, before anything new.
  std::optional<Arrival> next(Instant now);
  /// A message of next() is done: acked, given up, or its reader is gone. Others are ignored.
  void done(const Arrival& arrival);

  bool empty() const { return groups_.empty() && released_.empty(); }
  /// When next() has something (Instant::min(): now); nullopt: not by the passing of time alone.
  std::optional<Instant> due() const;
  /// Gives everything back to the broker.
  void clear();

 private:
  struct Group {
    std::deque<Arrival> waiting;     ///< in the order they came
    std::size_t failed = 0;          ///< of those that wait
    bool under_way = false;          ///< one of them is being tried
    std::optional<Instant> planned;  ///< stands in the agenda under this time
  };
  using Groups = std::map<std::string, Group>;

  static const std::string& driver_of(const Arrival& arrival);
  void insert(Group& group, Arrival arrival);
  void plan(Groups::value_type& entry);
  void unplan(Groups::value_type& entry);

  Groups groups_;                                     ///< by driver
  std::set<std::pair<Instant, std::string>> agenda_;  ///< groups without one under way, by the time of their first
  std::deque<Arrival> released_;                      ///< nothing before them has failed any more
};

}  // namespace iotcloud::topology
