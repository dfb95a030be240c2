#pragma once

#include <string>
#include <vector>

namespace iotcloud::topology::storm {

/// The shared libraries that some need, directly or not, as the dynamic loader finds them here.
struct NeededLibraries {
  std::vector<std::string> taken;     ///< paths: into the jar
  std::vector<std::string> expected;  ///< names: the C library's, which every worker machine has, as new as here
};

/// \param files paths of libraries; they are not in the answer. \throws config::Error for a library that is missing
/// here.
NeededLibraries needed_libraries(const std::vector<std::string>& files);

}  // namespace iotcloud::topology::storm
