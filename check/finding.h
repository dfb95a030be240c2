#pragma once

#include <string>
#include <vector>

namespace iotcloud::check {

/// How one thing was found.
enum class State {
  good,
  warning,  ///< it works now, and will not for ever, or not for everybody
  wrong,
};
/// "ok", "warning", "wrong"
const char* word_of(State state);

/// One thing that was looked at.
struct Finding {
  std::string area;  ///< "registry", "broker", "certificate", ...
  std::string what;  ///< which one: an address, a file
  State state = State::good;
  std::string says{};  ///< how it is
  std::string mend{};  ///< what to do about it; empty: nothing is to be done
};
using Findings = std::vector<Finding>;

}  // namespace iotcloud::check
