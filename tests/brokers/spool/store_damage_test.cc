// The log on disk: torn, damaged and missing files lose only the damaged part, and the loss is reported.
#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/spool/store/spool_reader.h"
#include "iotcloud/brokers/spool/store/spool_store.h"
#include "iotcloud/tests/brokers/spool/store_fixture.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::spool {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::SizeIs;

TEST_F(SpoolStoreTest, ATornTailOfAnyLengthIsCutAndTheRestKept) {
  {
    SpoolStore store(options());
    append(store, "first");
    append(store, "second");
  }
  const std::string path = only_segment();
  const std::string whole = read_all(path);
  std::size_t one = 0;
  {
    std::string head;
    encode_head(1, 1, sample("first"), head);
    one = Segment::file_start + head.size() + 5;
  }
  for (std::size_t size = one; size < whole.size(); ++size) {
    std::filesystem::remove_all(folder_ / "spool");
    std::filesystem::create_directories(folder_ / "spool");
    write_all(path, whole.substr(0, size));
    {
      SpoolStore store(options());
      ASSERT_EQ(store.found().torn_bytes, size - one) << size;
      EXPECT_EQ(store.found().damaged_bytes, 0u);
      ASSERT_THAT(bodies(store), ElementsAre("first")) << size;
      append(store, "third");
    }
    const SpoolStore again(options());
    EXPECT_EQ(again.found().torn_bytes, 0u);
    ASSERT_THAT(bodies(again), ElementsAre("first", "third")) << size;
  }
}

TEST_F(SpoolStoreTest, ASegmentThatWasOnlyJustBegunIsNoHindrance) {
  for (std::size_t size = 0; size <= Segment::file_start + 3; ++size) {
    std::filesystem::create_directories(folder_ / "spool");
    write_all(folder_ / "spool/00000000000000000007.segment",
              std::string("IOTSPOOL\1\0\0\0    \xF5re", 20).substr(0, size));
    SpoolStore store(options());
    EXPECT_EQ(store.found().messages, 0u);
    append(store, "x");
    EXPECT_THAT(bodies(store), ElementsAre("x")) << size;
    EXPECT_EQ(store.next_sequence(), 8u);
    store.raise_mark(8);
  }
}

TEST_F(SpoolStoreTest, AnyFlippedBitCostsOneMessageAtMostAndIsNoticed) {
  {
    SpoolStore store(options());
    for (const char* body : {"first", "second", "third"}) append(store, body);
  }
  const std::string path = only_segment();
  const std::string whole = read_all(path);
  for (std::size_t at = Segment::file_start; at < whole.size(); ++at) {
    std::filesystem::remove_all(folder_ / "spool");
    std::filesystem::create_directories(folder_ / "spool");
    std::string broken = whole;
    broken[at] = static_cast<char>(broken[at] ^ (1 << (at % 8)));
    write_all(path, broken);
    const SpoolStore store(options());
    std::vector<std::string> rest = bodies(store);
    ASSERT_EQ(rest.size(), 2u) << at;
    for (const auto& body : rest) EXPECT_THAT(body, testing::AnyOf("first", "second", "third"));
    EXPECT_TRUE(std::is_sorted(rest.begin(), rest.end()));
    const bool last_is_lost = rest.back() == "second";
    EXPECT_EQ(store.found().torn_bytes + store.found().damaged_bytes > 0, last_is_lost) << at;
  }
}

TEST_F(SpoolStoreTest, AFileWithDamageInTheMiddleIsKeptAside) {
  {
    SpoolStore store(options());
    for (const char* body : {"first", "second", "third"}) append(store, body);
  }
  std::string broken = read_all(only_segment());
  broken[broken.find("second")] = 'S';
  write_all(only_segment(), broken);
  {
    SpoolStore store(options());
    append(store, "fourth");
    SpoolReader reader(store);
    EXPECT_EQ(reader.next()->sequence, 1u);
    EXPECT_EQ(reader.next()->sequence, 3u);
    EXPECT_EQ(reader.next()->sequence, 4u);
    EXPECT_GT(reader.take_damaged_bytes(), 0u);
    store.raise_mark(5);
    store.release();
    EXPECT_THAT(files(store.folder(), ".damaged"), SizeIs(1));
  }
  const auto aside = files(folder_ / "spool", ".damaged");
  ASSERT_THAT(aside, SizeIs(1)) << "the folder is not removed then";
  EXPECT_EQ(read_all(aside.front()), broken);
}

TEST_F(SpoolStoreTest, ADamagedEndIsKeptAsideBeforeItIsCut) {
  {
    SpoolStore store(options());
    append(store, "first");
    append(store, "second");
  }
  std::string broken = read_all(only_segment());
  broken.back() = '?';
  write_all(only_segment(), broken);
  const SpoolStore store(options());
  EXPECT_THAT(bodies(store), ElementsAre("first"));
  EXPECT_GT(store.found().damaged_bytes, 0u);
  EXPECT_EQ(store.found().torn_bytes, 0u);
  EXPECT_THAT(files(store.folder(), ".damaged"), SizeIs(1));
}

TEST_F(SpoolStoreTest, ADamagedMarkMeansThatAllIsReadAgain) {
  {
    SpoolStore store(options());
    for (const char* body : {"first", "second", "third"}) append(store, body);
    store.raise_mark(2);
    store.raise_mark(3);
  }
  const std::string path = folder_ / "spool/mark";
  std::string mark = read_all(path);
  mark[0] ^= 1;
  write_all(path, mark);
  {
    const SpoolStore store(options());
    EXPECT_THAT(bodies(store), ElementsAre("second", "third")) << "the other place of the mark file is good";
    EXPECT_FALSE(store.found().mark_lost);
  }
  mark[512] ^= 1;
  write_all(path, mark);
  const SpoolStore store(options());
  EXPECT_TRUE(store.found().mark_lost);
  EXPECT_THAT(bodies(store), ElementsAre("first", "second", "third"));
}

TEST_F(SpoolStoreTest, AFileOfALaterVersionIsRefused) {
  {
    SpoolStore store(options());
    append(store, "1");
  }
  const std::string path = only_segment();
  std::string later = read_all(path);
  later[8] = 9;
  const std::uint32_t sum = checksum(std::as_bytes(std::span(later)).first(12));
  for (std::size_t i = 0; i < 4; ++i) later[12 + i] = static_cast<char>(sum >> (8 * i));
  write_all(path, later);
  try {
    const SpoolStore store(options());
    FAIL();
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("later version"));
  }
}

TEST_F(SpoolStoreTest, FilesThatWereTakenAwayAreMissed) {
  {
    SpoolStore store(options(16'000));
    for (int i = 1; i <= 40; ++i) append(store, std::to_string(i));
    store.raise_mark(2);
  }
  std::filesystem::remove(files(folder_ / "spool", ".segment").front());
  const SpoolStore store(options(16'000));
  EXPECT_GT(store.found().missing_messages, 0u);
}

TEST(SpoolRecordTest, LengthsThatCannotBeAreDamageAndNotAWishForMemory) {
  std::string head;
  encode_head(1, 1, sample(""), head);
  for (const char* length : {"\xff\xff\xff\xff", "\x00\x00\x00\x00", "\x01\x00\x00\x00"}) {
    std::string bytes = head;
    bytes.replace(4, 4, length, 4);
    EXPECT_EQ(decode_record(std::as_bytes(std::span(bytes))).kind, Decoded::Kind::damaged);
  }
}

TEST(SpoolRecordTest, FieldsThatReachBeyondTheRecordAreDamageEvenWithAGoodChecksum) {
  std::string head;
  encode_head(1, 1, sample("body"), head);
  head += "body";
  // Behind the start: sequence, accepted, time (24 bytes), then the length of the driver's id.
  head.replace(record_start + 24, 4, "\xff\xff\xff\x7f", 4);
  std::uint32_t sum = checksum(std::as_bytes(std::span(head)).subspan(4, 4));
  sum = checksum(std::as_bytes(std::span(head)).subspan(record_start), sum);
  for (std::size_t i = 0; i < 4; ++i) head[8 + i] = static_cast<char>(sum >> (8 * i));
  EXPECT_EQ(decode_record(std::as_bytes(std::span(head))).kind, Decoded::Kind::damaged);
}

}  // namespace
}  // namespace iotcloud::brokers::spool
