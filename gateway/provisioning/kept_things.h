#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <iotcloud/gateway/host/found_things.h>

namespace iotcloud::gateway {

/// Something that a finder found and an instance was made for, as a gateway keeps it across its restarts: a line of
/// JSON in its file.
struct KeptThing {
  std::string finder;  ///< its name
  FoundThing thing;
  static constexpr const char* what = "something for which a rule made an instance";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(finder, required), IOTCLOUD_FIELD(thing, required)};
};

/// Replaces the file, which its user alone may read. \return its size in bytes \throws config::Error when it cannot be
/// written
std::size_t write_kept_things(const std::string& file, const std::vector<KeptThing>& things);

/// What the file has; nothing if there is none. A line that is damaged, or could not have been found, is passed over
/// and logged, and so is a file that cannot be read: what is still there is found again.
std::vector<KeptThing> read_kept_things(const std::string& file);

}  // namespace iotcloud::gateway
