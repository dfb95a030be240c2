#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/topology/tuple_codec.h>

namespace iotcloud::topology {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

using Bytes = std::vector<std::byte>;

Bytes encoded(const TupleRecord& record) {
  Bytes bytes;
  encode_tuple(record, bytes);
  return bytes;
}
Bytes from_hex(const std::string& hex) {
  Bytes bytes;
  for (std::size_t i = 0; i < hex.size(); i += 3) {
    bytes.push_back(static_cast<std::byte>(std::stoi(hex.substr(i, 2), nullptr, 16)));
  }
  return bytes;
}
std::string error_of(const Bytes& bytes, const TupleLimits& limits = {}) {
  try {
    static_cast<void>(decode_tuple(Payload::take(bytes), limits));
  } catch (const TupleFormatError& error) {
    return error.what();
  }
  return "";
}
void expect_equal(const TupleRecord& a, const TupleRecord& b) {
  EXPECT_EQ(a.component, b.component);
  EXPECT_EQ(a.stream, b.stream);
  EXPECT_EQ(a.source_task, b.source_task);
  EXPECT_EQ(a.ids, b.ids);
  ASSERT_EQ(a.values.size(), b.values.size());
  for (std::size_t i = 0; i < a.values.size(); ++i) EXPECT_EQ(a.values[i], b.values[i]) << "value " << i;
}

/// One of everything.
TupleRecord sample() {
  TupleRecord record;
  record.component = "split";
  record.stream = "words";
  record.source_task = 7;
  record.ids = {1, 0xFEDCBA9876543210};
  record.values = Values(std::monostate(), false, true, -3, 1.5, "word", Payload::copy("frame"));
  return record;
}

/// A tuple as a runtime makes it.
struct Received final : detail::TupleData {
  explicit Received(const detail::StreamInfo& info) {
    stream = &info;
    handles = 1;  // never recycled
  }
  void recycle() noexcept override {}
};

TEST(TupleCodec, WritesTheBytesThatAreDocumented) {
  EXPECT_EQ(encoded(sample()), from_hex("C7 01 "
                                        "05 73 70 6C 69 74 "        // "split"
                                        "05 77 6F 72 64 73 "        // "words"
                                        "0E "                       // task 7
                                        "02 "                       // two ids
                                        "01 00 00 00 00 00 00 00 "  //
                                        "10 32 54 76 98 BA DC FE "  //
                                        "07 "                       // seven values
                                        "00 01 02 "                 // null, false, true
                                        "03 05 "                    // -3
                                        "04 00 00 00 00 00 00 F8 3F "
                                        "05 04 77 6F 72 64 "
                                        "06 05 66 72 61 6D 65"));
}

TEST(TupleCodec, ReadsWhatItWrote) {
  expect_equal(decode_tuple(Payload::take(encoded(sample()))), sample());
  expect_equal(decode_tuple(Payload::take(encoded({}))), {});
}

TEST(TupleCodec, KeepsNumbersAtTheirLimits) {
  TupleRecord record;
  for (const int task : {std::numeric_limits<int>::min(), -1, 0, 63, 64, std::numeric_limits<int>::max()}) {
    record.source_task = task;
    EXPECT_EQ(decode_tuple(Payload::take(encoded(record))).source_task, task);
  }
  using Limits = std::numeric_limits<std::int64_t>;
  record.values = Values(Limits::min(), Limits::max(), -1, 0, -64, 64, -0.0, std::numeric_limits<double>::infinity(),
                         std::numeric_limits<double>::denorm_min());
  const auto decoded = decode_tuple(Payload::take(encoded(record)));
  expect_equal(decoded, record);
  EXPECT_TRUE(std::signbit(std::get<double>(decoded.values[6])));
  record.values = Values(std::numeric_limits<double>::quiet_NaN());
  EXPECT_TRUE(std::isnan(std::get<double>(decode_tuple(Payload::take(encoded(record))).values[0])));
}

TEST(TupleCodec, KeepsStringsOfAnyBytesAndLength) {
  TupleRecord record;
  record.component = std::string("nul \0 \xff", 7);
  for (const std::size_t size : {0U, 1U, 127U, 128U, 16383U, 16384U, 1'000'000U}) {
    record.values.add(Value(std::string(size, '\0')));
    record.values.add(Value(Payload::take(std::string(size, 'p'))));
  }
  expect_equal(decode_tuple(Payload::take(encoded(record))), record);
}

TEST(TupleCodec, WritesAReceivedTupleAsItsRecord) {
  const detail::StreamInfo stream{"split", "words", Fields{"a", "b", "c", "d", "e", "f", "g"}};
  Received data(stream);
  data.values = sample().values;
  data.source_task = 7;
  Bytes bytes;
  {
    const Tuple tuple(&data);
    encode_tuple(tuple, sample().ids, bytes);
  }
  EXPECT_EQ(bytes, encoded(sample()));
}

TEST(TupleCodec, AppendsToWhatIsThere) {
  Bytes bytes(3, std::byte{9});
  encode_tuple(sample(), bytes);
  EXPECT_EQ(Bytes(bytes.begin() + 3, bytes.end()), encoded(sample()));
}

TEST(TupleCodec, SharesThePayloadsBytesAndKeepsThemAlive) {
  auto whole = std::make_unique<Payload>(Payload::take(encoded(sample())));
  const std::byte* first = whole->data();
  const std::size_t size = whole->size();
  const auto record = decode_tuple(*whole);
  whole.reset();
  const auto& payload = std::get<Payload>(record.values[6]);
  EXPECT_EQ(payload.data(), first + size - 5);
  EXPECT_EQ(payload.text(), "frame");
}

TEST(TupleCodec, RefusesATupleThatEndsAtAnyPlace) {
  const Bytes whole = encoded(sample());
  for (std::size_t size = 0; size < whole.size(); ++size) {
    EXPECT_THAT(error_of(Bytes(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size))),
                HasSubstr("the bytes end within"))
        << size << " bytes";
  }
}

TEST(TupleCodec, RefusesBytesBehindTheTuple) {
  Bytes bytes = encoded(sample());
  bytes.push_back(std::byte{0});
  EXPECT_THAT(error_of(bytes), HasSubstr("1 bytes follow"));
}

TEST(TupleCodec, SaysWhatIsWrong) {
  EXPECT_THAT(error_of(from_hex("C8 01 00 00 00 00 00")), HasSubstr("0xC7"));
  EXPECT_THAT(error_of(from_hex("C7 02 00 00 00 00 00")), HasSubstr("version 2"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 00 01 07")), HasSubstr("no value of kind 7"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 00 01 FF")), HasSubstr("byte 7: there is no value of kind 255"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 80 80 80 80 20 00 00")), HasSubstr("no task 4294967296"));
  EXPECT_THAT(error_of(from_hex("C7 01 80 00 00 00 00 00")), HasSubstr("more bytes than it needs"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 00 01 03 FF FF FF FF FF FF FF FF FF 02")), HasSubstr("64 bits"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 00 01 03 FF FF FF FF FF FF FF FF FF FF 01")), HasSubstr("64 bits"));
}

TEST(TupleCodec, HasLimitsForEverythingThatIsCounted) {
  EXPECT_THAT(error_of(encoded(sample()), {.name = 4}), HasSubstr("component's id is 5, the limit 4"));
  EXPECT_THAT(error_of(encoded(sample()), {.fields = 6}), HasSubstr("number of values is 7, the limit 6"));
  EXPECT_THAT(error_of(encoded(sample()), {.ids = 1}), HasSubstr("number of ids is 2, the limit 1"));
  EXPECT_THAT(error_of(encoded(sample()), {.bytes = 10}), HasSubstr("the limit is 10"));
  EXPECT_THAT(error_of(encoded(sample()), {.bytes = encoded(sample()).size(), .name = 5, .fields = 7, .ids = 2}),
              IsEmpty());
}

TEST(TupleCodec, AllocatesForNoMoreThanTheBytesHold) {
  // 2^63 and more of everything, with limits that would let them pass.
  const TupleLimits none{.bytes = SIZE_MAX, .name = SIZE_MAX, .fields = SIZE_MAX, .ids = SIZE_MAX};
  const std::string huge = "FF FF FF FF FF FF FF FF FF 01 ";
  EXPECT_THAT(error_of(from_hex("C7 01 " + huge), none), HasSubstr("the bytes end within the length of the comp"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 " + huge), none), HasSubstr("the bytes end within the number of ids"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 00 " + huge), none), HasSubstr("end within the number of values"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 00 01 05 " + huge), none), HasSubstr("the length of a string"));
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 00 01 06 " + huge), none), HasSubstr("the length of a payload"));
  // 2^61 ids: eight times as many bytes overflow.
  EXPECT_THAT(error_of(from_hex("C7 01 00 00 00 80 80 80 80 80 80 80 80 20 00"), none), HasSubstr("number of ids"));
}

/// Whatever is read is written as the same bytes, so nothing else can have been meant.
void read_and_write_again(const Bytes& bytes) {
  TupleRecord record;
  try {
    record = decode_tuple(Payload::take(bytes));
  } catch (const TupleFormatError& error) {
    EXPECT_LE(error.offset(), bytes.size());
    return;
  }
  EXPECT_EQ(encoded(record), bytes);
}

TEST(TupleCodec, RefusesOrUnderstandsWhateverBecomesOfItsBytes) {
  std::mt19937 random(20261121);
  const auto below = [&](std::size_t limit) {
    return std::uniform_int_distribution<std::size_t>(0, limit - 1)(random);
  };
  const Bytes whole = encoded(sample());
  for (int round = 0; round < 50'000; ++round) {
    Bytes bytes = whole;
    for (std::size_t changes = 1 + below(4); changes > 0; --changes) {
      const auto at = static_cast<std::ptrdiff_t>(below(bytes.size()));
      switch (below(4)) {
        case 0:
          bytes[static_cast<std::size_t>(at)] = static_cast<std::byte>(below(256));
          break;
        case 1:
          bytes[static_cast<std::size_t>(at)] ^= static_cast<std::byte>(1U << below(8));
          break;
        case 2:
          bytes.insert(bytes.begin() + at, static_cast<std::byte>(below(256)));
          break;
        default:
          if (bytes.size() > 1) bytes.erase(bytes.begin() + at);
      }
    }
    read_and_write_again(bytes);
  }
}

TEST(TupleCodec, ReadsWhatItWroteOfTuplesMadeAtRandom) {
  std::mt19937_64 random(20261121);
  const auto below = [&](std::size_t limit) {
    return std::uniform_int_distribution<std::size_t>(0, limit - 1)(random);
  };
  const auto text = [&] {
    std::string made(below(300), '\0');
    for (char& c : made) c = static_cast<char>(below(256));
    return made;
  };
  for (int round = 0; round < 2'000; ++round) {
    TupleRecord record;
    record.component = text();
    record.stream = text();
    record.source_task = static_cast<int>(random());
    for (std::size_t ids = below(4); ids > 0; --ids) record.ids.push_back(random());
    for (std::size_t fields = below(12); fields > 0; --fields) {
      switch (below(6)) {
        case 0:
          record.values.add({});
          break;
        case 1:
          record.values.add(below(2) == 1);
          break;
        case 2:
          record.values.add(static_cast<std::int64_t>(random() >> below(64)));
          break;
        case 3:
          record.values.add(static_cast<double>(random()) / 3);
          break;
        case 4:
          record.values.add(text());
          break;
        default:
          record.values.add(Payload::take(text()));
      }
    }
    expect_equal(decode_tuple(Payload::take(encoded(record))), record);
  }
}

}  // namespace
}  // namespace iotcloud::topology
