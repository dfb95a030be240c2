#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

struct TapRequest {
  std::string component;
  std::string stream;        ///< only tuples of this stream; empty: of all streams
  double rate = 10;          ///< the most samples a second of each task
  std::int64_t samples = 0;  ///< number of samples after which the tap ends; 0: it ends when it is interrupted
};

/// Shows samples of the tuples of a component in all workers, until there are enough or the user interrupts it. Then it
/// ends the workers' taps, too. \return the exit status. \throws RequestFailed
int tap(Call& call, const TapRequest& request, const discovery::TopologyStatus& topology, MasterClient& master);

}  // namespace iotcloud::master::cli
