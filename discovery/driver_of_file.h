#pragma once

#include <string>

#include <iotcloud/discovery/ids.h>

namespace iotcloud::discovery {

/// The name of a driver that nothing else names: that of its plugin's file, "turtle" for "turtle.so".
inline DriverName driver_of_file(const std::string& plugin) {
  return DriverName(plugin.substr(0, plugin.rfind('.')));
}

}  // namespace iotcloud::discovery
