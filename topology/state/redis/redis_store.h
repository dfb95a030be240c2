#pragma once

#include <memory>
#include <string>

#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::internal {

/// A store in Redis, which workers on several machines share. It connects when it is first used. \param url
/// "redis://..." or "rediss://...". \throws StateError for a URL that is none, or that is not safe.
std::shared_ptr<StateStore> open_redis(const std::string& url);

}  // namespace iotcloud::topology::internal
