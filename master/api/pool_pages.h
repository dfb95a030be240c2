#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/discovery/submissions.h>
#include <iotcloud/master/gateways/pool_client.h>
#include <iotcloud/master/orders/answers.h>

namespace iotcloud::master {

class Master;

/// A part of the log of the workers at a place of a submitted topology, from the pool that has it.
/// \throws config::Error when no pool has it, or the pool cannot be asked
LogPart read_worker_log(const Master& master, const PoolAccess& access, const discovery::PlaceId& place,
                        const std::string& position, std::int32_t most_bytes);

}  // namespace iotcloud::master
