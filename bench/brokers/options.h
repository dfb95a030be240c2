#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

namespace iotcloud::bench {

/// Options of the programs of `./dev bench brokers`.
struct BrokerOptions {
  std::string url;
  std::string name;      ///< prefix of the topics: each kind of run needs its own, so that runs never share queues
  unsigned drivers = 4;  ///< each with topics of its own, unless `shared`
  bool shared = false;   ///< one topic for all drivers in each direction
  std::size_t size = 100;
  double rate = 0;               ///< messages a second of each driver; 0: a closed loop
  unsigned under_way = 8;        ///< in the closed loop, over all drivers
  bool idle = false;             ///< connect and send nothing
  bool confirms = true;          ///< only bare clients can do without
  bool acknowledgements = true;  ///< only bare clients can do without
  bool devices_only = false;     ///< `processors` are the cloud end (RabbitMQ's bare client)
  double warm_up = 0.5, seconds = 2;
  std::vector<pid_t> server;  ///< processes of the server, whose CPU time is reported separately
  /// processes that send back the devices' messages; their CPU time is reported separately
  std::vector<pid_t> processors;
};

/// \return nothing for wrong arguments, after printing the usage.
std::optional<BrokerOptions> parse_broker_options(int argc, char** argv);

}  // namespace iotcloud::bench
