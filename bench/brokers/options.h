#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

namespace iotcloud::bench {

/// What a program of `./dev bench brokers` is told.
struct BrokerOptions {
  std::string url;
  std::string name;      ///< prefix of the topics: another one for each kind of run, so that queues are never shared
  unsigned drivers = 4;  ///< each with topics of its own, unless `shared`
  bool shared = false;   ///< one topic for all drivers in each direction
  std::size_t size = 100;
  double rate = 0;               ///< messages a second of each driver; 0: a closed loop
  unsigned under_way = 8;        ///< in the closed loop, over all drivers
  bool idle = false;             ///< connect and send nothing
  bool confirms = true;          ///< only bare clients can do without
  bool acknowledgements = true;  ///< likewise
  bool devices_only = false;     ///< the cloud end is somebody else's, from `processors` (RabbitMQ's bare client)
  double warm_up = 0.5, seconds = 2;
  std::vector<pid_t> server;      ///< processes of the server, whose CPU time is told apart
  std::vector<pid_t> processors;  ///< those that send back what the devices send, likewise
};

/// \return nothing when the words make no sense; the usage was printed then.
std::optional<BrokerOptions> parse_broker_options(int argc, char** argv);

}  // namespace iotcloud::bench
