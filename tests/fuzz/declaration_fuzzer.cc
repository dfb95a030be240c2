// What a plugin says of itself: its bytes, as anybody may send them to a gateway, and the JSON of them that a gateway
// answers to the command line.
#include "iotcloud/config/declaration.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(declaration, 1'500) {
  const auto input = fuzz::text(data, size);
  for (const auto& declaration : {config::declaration_in(input), config::parse_declaration(input)}) {
    const auto again = config::parse_declaration(config::to_json(declaration));
    fuzz::must(again == declaration, "a declaration is read as it was written");
    const auto properties = config::with_defaults({{"rate", "30"}}, declaration);
    const auto problems = config::problems_of(properties, declaration);
    fuzz::must(problems.empty() == config::text_of(problems).empty(), "each problem has a text");
  }
}
