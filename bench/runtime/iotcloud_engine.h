#pragma once

#include <memory>

#include <iotcloud/bench/runtime/workload.h>

namespace iotcloud::bench {

/// Our own runtime. It runs when this returns; `work` must outlive it, and its feed is started.
std::unique_ptr<Engine> make_iotcloud_engine(Workload& work);

}  // namespace iotcloud::bench
