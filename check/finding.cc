#include <iotcloud/check/finding.h>

namespace iotcloud::check {

const char* word_of(State state) {
  switch (state) {
    case State::warning:
      return "warning";
    case State::wrong:
      return "wrong";
    case State::good:
      break;
  }
  return "ok";
}

}  // namespace iotcloud::check
