#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/host/event_loop.h>
#include <iotcloud/gateway/host/found_things.h>
#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/host/shared_channels.h>

namespace iotcloud::gateway {

/// The objects that all instances of a host share. The instances own them together, so that a hanging instance may
/// outlive the host.
struct HostEnvironment {
  discovery::GatewayId gateway;
  bool isolated = false;  ///< this host runs one instance only; other instances of the driver run in other hosts
  std::chrono::milliseconds drain_limit{1000};
  std::string state_folder;  ///< the folder that contains the spools; empty: spools are not possible
  std::shared_ptr<const Plugin> plugin;
  const config::Clock* clock = nullptr;
  config::Metrics* metrics = nullptr;
  config::Histogram round_trips;  ///< of all instances
  std::unique_ptr<brokers::BrokerPool> brokers;
  std::unique_ptr<SharedChannels> shared_channels;
  /// The thread on which publishers are drained and late messages are given up, so that event threads do not wait.
  std::shared_ptr<EventLoop> closing;
  std::function<void(const InstanceStatus&)> report;
  std::function<void(FoundReport)> report_found;  ///< what an instance that is a finder tells; never empty

  /// The thread that opens and closes spooled channels: both may wait for the disk, which no event thread does. It is
  /// not `closing`, so that a failure is not reported after others' drains. It starts with the first spool.
  EventLoop& spools() {
    std::call_once(spools_started_, [this] { spools_ = std::make_unique<EventLoop>("spools"); });
    return *spools_;
  }

 private:
  std::once_flag spools_started_;
  std::unique_ptr<EventLoop> spools_;
};

}  // namespace iotcloud::gateway
