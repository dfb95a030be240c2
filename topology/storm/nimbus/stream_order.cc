#include <tuple>

#include "iotcloud/topology/storm/storm_types.h"

namespace iotcloud::topology::storm::idl {

/// Orders the keys of ComponentCommon::inputs; Thrift only declares it.
bool GlobalStreamId::operator<(const GlobalStreamId& other) const {
  return std::tie(componentId, streamId) < std::tie(other.componentId, other.streamId);
}

}  // namespace iotcloud::topology::storm::idl
