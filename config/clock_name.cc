#include <fstream>

#include <iotcloud/config/clock_name.h>

namespace iotcloud::config {

const std::string& system_clock_name() {
  static const std::string name = [] {
    std::ifstream file("/proc/sys/kernel/random/boot_id");
    std::string read;
    std::getline(file, read);
    return read;
  }();
  return name;
}

}  // namespace iotcloud::config
