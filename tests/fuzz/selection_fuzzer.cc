// Expressions that select drivers, as anybody may write them in a topology's file or on a command line.
#include <string>

#include "iotcloud/discovery/selection/selection.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(selection, 10'000) {
  static const discovery::DriverRecord driver = [] {
    discovery::DriverRecord record;
    record.metadata = {{"a", "1"}, {"location", "39.17,-86.52"}, {"site", "lab"}, {"x", "1"}, {"y", ""}};
    return record;
  }();
  try {
    static_cast<void>(discovery::Selection::parse(fuzz::text(data, size)).matches(driver));
  } catch (const discovery::SelectionError& error) {
    fuzz::must(error.offset() <= size && error.line() >= 1 && error.column() >= 1, "an error's place is in the text");
    fuzz::must(!error.problem().empty(), "an error says what was expected");
  }
}
