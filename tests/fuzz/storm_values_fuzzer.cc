// A tuple's values as a C++ component in Storm gets them: Java writes what any other worker has sent. Bit 0 of the
// first byte says whether the last value is a birth, bit 1 whether large arrays came beside the bytes, and the other
// bits how many.
#include <algorithm>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/topology/storm/value_format.h"

using namespace iotcloud;
namespace storm = topology::storm;

namespace {

class Arrays final : public storm::JavaArrays {
 public:
  explicit Arrays(std::size_t count) : left_(count) {}
  topology::Payload next() override {
    if (left_ == 0) throw storm::ValueFormatError("there is no further array");
    auto array = topology::Payload::copy(std::string(left_--, 'x'));
    taken_.insert(array.data());
    return array;
  }
  std::size_t left() const { return left_; }
  bool is_one(const topology::Value& value) const {
    const auto* payload = std::get_if<topology::Payload>(&value);
    return payload != nullptr && taken_.contains(payload->data());
  }

 private:
  std::size_t left_;
  std::set<const std::byte*> taken_;
};

}  // namespace

IOTCLOUD_FUZZ_TARGET(storm_values, 50'000) {
  if (size == 0) return;
  const bool births = (*data & 1U) != 0;
  const bool has_arrays = (*data & 2U) != 0;
  Arrays arrays(*data >> 2U);
  const auto bytes = std::as_bytes(std::span(data + 1, size - 1));
  try {
    std::int64_t birth = 0;
    auto values = storm::decode_values(bytes, births ? &birth : nullptr, has_arrays ? &arrays : nullptr);
    if (births) values.add(birth);
    std::vector<std::optional<storm::JavaValue>> elsewhere(values.size());
    for (std::size_t i = 0; i < values.size(); ++i) {
      if (arrays.is_one(values[i])) elsewhere[i] = storm::JavaValue{};
    }
    std::vector<std::byte> again(storm::encoded_size(values.all(), elsewhere));
    const auto* const end = storm::encode_values(values.all(), again.data(), elsewhere);
    fuzz::must(end == again.data() + again.size(), "values take the bytes that were said");
    fuzz::must(std::equal(again.begin(), again.end(), bytes.begin(), bytes.end()), "values are written as they came");
  } catch (const storm::ValueFormatError&) {  // NOLINT(bugprone-empty-catch): the tuple fails
  }
}
