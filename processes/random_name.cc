#include <random>

#include <fmt/format.h>

#include <iotcloud/processes/random_name.h>

namespace iotcloud::processes {

std::string random_name() {
  std::random_device random;
  std::string name;
  for (int word = 0; word < 4; ++word) name += fmt::format("{:08x}", random());
  return name;
}

}  // namespace iotcloud::processes
