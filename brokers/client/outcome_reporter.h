#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>

#include "iotcloud/brokers/client/outbox.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::client {

/// Calls the callbacks of the publishers of one connection, one thread at a time for each publisher and without the
/// connection's mutex. All methods want that mutex held; `lock` holds it and is released while callbacks run.
class OutcomeReporter {
 public:
  using Lock = std::unique_lock<std::mutex>;
  /// \param changed the connection's; notified when callbacks ended. Both outlive this.
  OutcomeReporter(std::condition_variable& changed, Meters& meters) : changed_(changed), meters_(meters) {}

  /// Puts the publisher on the list of those with something to report, when it has something.
  void note(const std::shared_ptr<Outbox>& outbox);
  bool due() const { return !to_report_.empty(); }
  /// Reports one publisher's outcomes here; waits for another thread that does so.
  void report(const std::shared_ptr<Outbox>& outbox, Lock& lock);
  void report_all(Lock& lock);
  /// Waits until everything accepted has an outcome that was reported. \return false when `limit` passed first.
  bool drain(const std::shared_ptr<Outbox>& outbox, std::chrono::milliseconds limit, Lock& lock);

 private:
  std::condition_variable& changed_;
  Meters& meters_;
  std::deque<std::shared_ptr<Outbox>> to_report_;
};

}  // namespace iotcloud::brokers::client
