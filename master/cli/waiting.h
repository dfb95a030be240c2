#pragma once

#include <functional>
#include <stop_token>
#include <string>
#include <thread>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>

namespace iotcloud::master::cli {

struct Call;

/// While it lives, and from a second on: says on `Call::err` what the instances that an order is about are waiting for,
/// once for each state and reason. The order itself waits on another connection meanwhile; nothing but say() may write
/// to `Call::err`.
class WaitingReport {
 public:
  using Concerns = std::function<bool(const discovery::DriverRecord&)>;
  /// \param concerns whether the order is about an instance; called on a thread of this object.
  WaitingReport(const Call& call, Concerns concerns);

  /// Writes a line between the others. Any thread may call it.
  void say(const std::string& line);

 private:
  void ask_and_tell(const std::stop_token& stop);

  const Call& call_;
  const Concerns concerns_;
  config::Mutex writing_;
  std::jthread asking_;
};

}  // namespace iotcloud::master::cli
