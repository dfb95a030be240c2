#pragma once

#include <cstddef>
#include <string>
#include <utility>

#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Says, in metrics, the log and the worker's record, when the prefetch of a spout component holds its topology up:
/// messages wait at the broker although the spout has nothing to emit, because as many messages as the broker hands out
/// are in the topology, unsettled. A window, or a bolt that acks late, gets only so many at a time. Not thread safe.
class PrefetchReport {
 public:
  /// \param own_prefetch the spout's YAML sets `prefetchCount`, so that readers do not raise it.
  PrefetchReport(EndpointServicesPtr services, std::string component, bool own_prefetch)
      : services_(std::move(services)), component_(std::move(component)), own_prefetch_(own_prefetch) {}

  /// To be called twice a second, with what the readers are like then. Several looks in a row make a limit.
  /// \param limited the number of channels of which as many messages as the broker hands out are unsettled; 0 while
  /// the spout has something to emit. \param most the greatest prefetch of a channel.
  void look(std::size_t limited, std::size_t most);

 private:
  std::string text(std::size_t limited, std::size_t most) const;

  const EndpointServicesPtr services_;
  const std::string component_;
  const bool own_prefetch_;
  int limited_looks_ = 0;  ///< looks in a row with a channel that is limited
};

}  // namespace iotcloud::topology
