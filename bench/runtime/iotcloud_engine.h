#pragma once

#include <memory>

#include <iotcloud/bench/runtime/workload.h>

namespace iotcloud::bench {

/// Makes our own runtime, already running. `work` must outlive it, and its feed must be started.
std::unique_ptr<Engine> make_iotcloud_engine(Workload& work);

}  // namespace iotcloud::bench
