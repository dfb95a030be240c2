// A tuple's bytes, as an engine gives them to another process.
#include <algorithm>
#include <cstddef>
#include <vector>

#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/topology/tuple_codec.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(tuple, 20'000) {
  try {
    const auto record = topology::decode_tuple(topology::Payload::copy(fuzz::text(data, size)));
    std::vector<std::byte> again;
    topology::encode_tuple(record, again);
    fuzz::must(again.size() == size && std::equal(again.begin(), again.end(), reinterpret_cast<const std::byte*>(data)),
               "a tuple that can be read has one form");
  } catch (const topology::TupleFormatError& error) {
    fuzz::must(error.offset() <= size, "the error's place is in the bytes");
  }
}
