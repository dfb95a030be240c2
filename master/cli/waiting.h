#pragma once

#include <functional>
#include <thread>

#include <iotcloud/discovery/records.h>

namespace iotcloud::master::cli {

struct Call;

/// While it lives, and from a second on: says on `Call::err` what the instances that an order is about are waiting for,
/// once for each state and reason. The order itself waits on another connection meanwhile, so nothing else may be
/// written to `Call::err`.
class Waiting {
 public:
  using Concerns = std::function<bool(const discovery::DriverRecord&)>;
  Waiting(const Call& call, Concerns concerns);

 private:
  std::jthread asking_;
};

}  // namespace iotcloud::master::cli
