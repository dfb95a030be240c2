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
#include <iotcloud/topology/endpoints/receiving/inbox.h>
#include <iotcloud/topology/endpoints/receiving/verdicts.h>

namespace iotcloud::topology {

/// On a shared channel, lets pass what comes from instances that `where` chooses. What others send is accepted and
/// dropped, and counted. A driver's first message may be here before the registry has told of it: it waits `grace`, and
/// what the driver sends behind it with it. Belongs to one spout task; not thread safe.
class SharedFilter {
 public:
  SharedFilter(std::shared_ptr<const Verdicts> verdicts, config::Counter& dropped)
      : verdicts_(std::move(verdicts)), dropped_(dropped) {}

  /// \return the message when it is to go on; otherwise it was dropped, or waits.
  std::optional<Arrival> pass(Arrival arrival, config::Clock::Instant now);
  /// What has waited and may go on now; what waited too long is dropped. Empty: there is none.
  std::optional<Arrival> next(config::Clock::Instant now);
  /// Nothing more should be brought: too many messages of drivers that are not known wait.
  bool full() const { return waiting_count_ >= most_waiting; }
  bool empty() const { return waiting_count_ == 0; }
  /// What waits goes back to the broker.
  void clear();

  static constexpr std::chrono::seconds grace{2};
  static constexpr std::size_t most_waiting = 1024;
  /// How often to look for new verdicts while something waits.
  static constexpr std::chrono::milliseconds look_again{10};

 private:
  struct Waiting {
    Arrival arrival;
    config::Clock::Instant since;
  };
  void drop(Arrival& arrival);

  const std::shared_ptr<const Verdicts> verdicts_;
  config::Counter& dropped_;
  std::map<std::string, std::deque<Waiting>> waiting_;  ///< by driver instance, never empty ones
  std::size_t waiting_count_ = 0;
};

}  // namespace iotcloud::topology
