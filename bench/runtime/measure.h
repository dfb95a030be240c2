#pragma once

#include <functional>
#include <memory>

#include <iotcloud/bench/runtime/workload.h>

namespace iotcloud::bench {

using MakeEngine = std::function<std::unique_ptr<Engine>(Workload&)>;

/// The main program of an engine: reads the options, runs the DAG, measures, checks that all items arrived, and prints
/// one line of JSON. \return exit status; 1: something was lost, failed or copied.
int measure(const char* engine, int argc, char** argv, const MakeEngine& make);

}  // namespace iotcloud::bench
