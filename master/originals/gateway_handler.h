#pragma once

#include <functional>
#include <memory>

namespace apache::thrift {
class TProcessorFactory;
}

namespace iotcloud::master {

class OriginalGateways;
struct MasterStatus;

/// Serves TMasterService, to which gateways of the original system register. A standby master refuses and names the
/// leader. The arguments outlive all connections. \param status of the master that serves.
std::shared_ptr<apache::thrift::TProcessorFactory> serve_original_gateways(OriginalGateways& gateways,
                                                                           std::function<MasterStatus()> status);

}  // namespace iotcloud::master
