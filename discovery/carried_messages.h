#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <string>

namespace iotcloud::discovery {

/// What the drivers of one host process of a gateway have carried since the process began.
struct CarriedMessages {
  std::string host;                  ///< the process's name in the gateway's metrics
  std::chrono::milliseconds age{0};  ///< so long ago it told this
  std::uint64_t sent = 0;            ///< messages of drivers that a broker has confirmed
  std::uint64_t received = 0;        ///< messages that were handed to drivers
  /// Messages of drivers that were answered, by how long that took: the upper end of a range, in microseconds, and how
  /// many are in it.
  std::map<double, std::uint64_t> round_trips{};
  friend bool operator==(const CarriedMessages&, const CarriedMessages&) = default;
};

}  // namespace iotcloud::discovery
