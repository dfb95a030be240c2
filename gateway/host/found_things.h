#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>

namespace iotcloud::gateway {

/// Something that a finder found: a device that announced itself, say.
struct FoundThing {
  std::string key;                                ///< unique for its finder
  std::map<std::string, std::string> attributes;  ///< as the finder tells them: input, which nobody has checked
  static constexpr const char* what = "something that was found";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(key, required), IOTCLOUD_FIELD(attributes, required)};
  friend bool operator==(const FoundThing&, const FoundThing&) = default;
};

/// What a finder tells: all that it finds, or changes of that.
struct FoundReport {
  discovery::InstanceId finder;
  bool whole = false;  ///< what earlier reports told is void
  bool sees = false;   ///< drivers::HostInterface::report_sight()
  std::vector<FoundThing> found;
  std::vector<std::string> gone;  ///< keys
  static constexpr const char* what = "a report of a finder";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(finder, required), IOTCLOUD_FIELD(whole, usual), IOTCLOUD_FIELD(sees, usual),
                 IOTCLOUD_FIELD(found, usual), IOTCLOUD_FIELD(gone, usual)};
};

// What one finder may tell, in its host and to a gateway.
inline constexpr std::size_t most_found = 10'000;      ///< things
inline constexpr std::size_t longest_found_key = 256;  ///< bytes
inline constexpr std::size_t most_attributes = 64;
inline constexpr std::size_t most_attribute_bytes = std::size_t{16} * 1024;  ///< of all attributes of one thing

/// Why this cannot be told as something that was found; empty: it can.
std::string problem_of(const FoundThing& thing);

/// What an instance in its host has found, and what of it was not reported yet. Not thread safe.
class FoundThings {
 public:
  /// \return why it is not taken; empty: it is
  std::string found(FoundThing thing);
  void gone(std::string_view key);
  void sight(bool sees);
  /// Whether a report is due.
  bool changed() const { return changed_; }
  std::uint64_t refused() const { return refused_; }  ///< so many calls of found() were not taken
  /// The reports of what changed since the last call, each of a moderate size. \param whole all that there is, for
  /// somebody who knows nothing; none if this instance never told anything
  std::vector<FoundReport> take(const discovery::InstanceId& finder, bool whole);

 private:
  std::map<std::string, FoundThing, std::less<>> things_;
  std::set<std::string, std::less<>> fresh_, gone_;  ///< keys that changed since the last report
  bool told_ = false;                                ///< something was ever reported
  bool anew_ = false;                                ///< the next report is whole
  bool sees_ = false;
  bool changed_ = false;
  std::uint64_t refused_ = 0;
};

}  // namespace iotcloud::gateway
