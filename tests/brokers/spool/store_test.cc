// The log on disk: what is in it comes back, in order, whatever happened to the files.
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/limits.h"
#include "iotcloud/brokers/spool/spool_reader.h"
#include "iotcloud/brokers/spool/spool_store.h"
#include "iotcloud/tests/brokers/spool/spool_fixture.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::spool {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class SpoolStoreTest : public testing::Test {
 protected:
  SpoolStore::Options options(std::uint64_t max_bytes = 1 << 20) {
    SpoolStore::Options options;
    options.folder = folder_ / "spool";
    options.max_bytes = max_bytes;
    options.disk = &disk_;
    return options;
  }
  static void append(SpoolStore& store, const std::string& body) {
    Position where;
    ASSERT_EQ(store.append(1, sample(body), where), SpoolStore::Append::stored) << store.problem();
  }
  static std::vector<std::string> bodies(const SpoolStore& store) {
    std::vector<std::string> all;
    SpoolReader reader(store);
    while (const auto record = reader.next()) {
      if (record->sequence >= store.mark()) all.emplace_back(record->message.payload.text());
    }
    return all;
  }
  std::string only_segment() const {
    const auto all = files(folder_ / "spool", ".segment");
    EXPECT_THAT(all, SizeIs(1));
    return all.empty() ? "" : all.front();
  }

  TemporaryFolder folder_;
  TestDisk disk_;
};

TEST_F(SpoolStoreTest, AMessageComesBackWithAllItsMetadataWhateverItsBytes) {
  Message message;
  std::string every_byte;
  for (int i = 0; i < 256; ++i) every_byte.push_back(static_cast<char>(i));
  message.payload = Payload::copy(every_byte + every_byte);
  message.driver_id = std::string("d\0\xff", 3);
  message.gateway_id = "gateway 1";
  message.time_ms = -5;
  message.properties.set(std::string("\0key", 4), every_byte);
  message.properties.set("", "");
  Position where;
  {
    SpoolStore store(options());
    ASSERT_EQ(store.append(1234567890123, message, where), SpoolStore::Append::stored);
  }
  const SpoolStore store(options());
  SpoolReader reader(store);
  const auto record = reader.next();
  ASSERT_TRUE(record);
  EXPECT_EQ(record->sequence, 1u);
  EXPECT_EQ(record->accepted_ms, 1234567890123);
  EXPECT_EQ(record->message.payload, message.payload);
  EXPECT_EQ(record->message.driver_id, message.driver_id);
  EXPECT_EQ(record->message.gateway_id, message.gateway_id);
  EXPECT_EQ(record->message.time_ms, message.time_ms);
  EXPECT_EQ(record->message.properties, message.properties);
  EXPECT_FALSE(reader.next());
}

TEST_F(SpoolStoreTest, AMessageWithoutAPayloadComesBackToo) {
  Message empty;
  empty.driver_id = "d1";
  Position where;
  SpoolStore store(options());
  ASSERT_EQ(store.append(1, empty, where), SpoolStore::Append::stored);
  ASSERT_EQ(store.append(1, {}, where), SpoolStore::Append::stored);
  SpoolReader reader(store);
  for (const char* driver : {"d1", ""}) {
    const auto record = reader.next();
    ASSERT_TRUE(record);
    EXPECT_TRUE(record->message.payload.empty());
    EXPECT_EQ(record->message.driver_id, driver);
  }
}

TEST_F(SpoolStoreTest, ReadsInOrderOverManySegmentsAndSeveralLives) {
  std::vector<std::string> expected;
  for (int life = 0; life < 3; ++life) {
    SpoolStore store(options(100'000));
    EXPECT_EQ(store.found().messages, expected.size());
    for (int i = 0; i < 200; ++i) {
      expected.push_back(std::to_string(life) + "." + std::to_string(i));
      append(store, expected.back());
    }
  }
  const SpoolStore store(options(100'000));
  EXPECT_EQ(bodies(store), expected);
  EXPECT_GT(files(folder_ / "spool", ".segment").size(), 4u);
}

TEST_F(SpoolStoreTest, AReaderFollowsTheWriter) {
  SpoolStore store(options(20'000));
  SpoolReader reader(store);
  for (int i = 0; i < 100; ++i) {
    append(store, std::to_string(i));
    const auto record = reader.next();
    ASSERT_TRUE(record);
    EXPECT_EQ(record->message.payload.text(), std::to_string(i));
    EXPECT_FALSE(reader.next());
  }
}

TEST_F(SpoolStoreTest, SegmentsThatAreDoneWithAreRemovedAndTheMarkOutlivesTheProcess) {
  {
    SpoolStore store(options(20'000));
    for (int i = 1; i <= 100; ++i) append(store, std::to_string(i));
    const std::size_t before = files(store.folder(), ".segment").size();
    store.raise_mark(91);
    EXPECT_TRUE(store.releasable());
    store.release();
    EXPECT_FALSE(store.releasable());
    EXPECT_LT(files(store.folder(), ".segment").size(), before);
    store.raise_mark(5);  // lower: ignored
  }
  const SpoolStore store(options(20'000));
  EXPECT_EQ(store.found().messages, 10u);
  EXPECT_EQ(bodies(store).front(), "91");
}

TEST_F(SpoolStoreTest, NothingIsLeftOfASpoolThatIsEmpty) {
  {
    SpoolStore store(options());
    append(store, "1");
    store.raise_mark(2);
  }
  EXPECT_FALSE(std::filesystem::exists(folder_ / "spool"));
}

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

TEST_F(SpoolStoreTest, AFolderThatIsInUseIsRefused) {
  const SpoolStore store(options());
  try {
    const SpoolStore second(options());
    FAIL() << "two stores in one folder";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr(folder_ / "spool"));
    EXPECT_THAT(error.what(), HasSubstr("in use"));
  }
}

TEST_F(SpoolStoreTest, AFolderThatIsJustBeingGivenUpIsWaitedFor) {
  auto first = std::make_unique<SpoolStore>(options());
  append(*first, "1");
  std::promise<void> opening;
  std::jthread closing([&] {
    opening.get_future().wait();
    first.reset();
  });
  SpoolStore::Options patient = options();
  patient.lock_limit = std::chrono::seconds(60);
  opening.set_value();
  const SpoolStore second(patient);
  EXPECT_THAT(bodies(second), ElementsAre("1"));
}

TEST_F(SpoolStoreTest, AFolderThatCannotBeMadeIsRefused) {
  write_all(folder_ / "spool", "a file");
  EXPECT_THROW(SpoolStore{options()}, config::Error);
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

TEST_F(SpoolStoreTest, IsFullAtItsLimitAndHasRoomAgainWhenTheFirstAreDoneWith) {
  SpoolStore store(options(16'000));
  const std::string body(500, 'x');
  Position where;
  while (store.append(1, sample(body), where) == SpoolStore::Append::stored) {
  }
  EXPECT_EQ(store.append(1, sample(body), where), SpoolStore::Append::full);
  EXPECT_LE(store.bytes(), 16'000u);
  EXPECT_FALSE(store.has_room(store.last_size()));
  store.raise_mark(5);
  store.release();
  EXPECT_TRUE(store.has_room(store.last_size()));
  append(store, body);
}

TEST_F(SpoolStoreTest, AMessageAsLargeAsTheSpoolFitsWhenAllElseIsDoneWith) {
  SpoolStore store(options(16'000));
  append(store, std::string(10'000, 'x'));
  Position where;
  const Message large = sample(std::string(15'000, 'y'));
  EXPECT_EQ(store.append(1, large, where), SpoolStore::Append::full);
  store.raise_mark(2);
  EXPECT_EQ(store.append(1, large, where), SpoolStore::Append::stored);
  EXPECT_EQ(store.append(1, sample(std::string(16'000, 'z')), where), SpoolStore::Append::too_large);
}

TEST_F(SpoolStoreTest, DropsTheOldestSegmentWhenToldTo) {
  SpoolStore store(options(16'000));
  for (int i = 1; i <= 40; ++i) append(store, std::to_string(i));
  const std::uint64_t kept = store.drop_oldest();
  EXPECT_GT(kept, 1u);
  EXPECT_LT(kept, 40u);
  EXPECT_EQ(bodies(store).front(), std::to_string(kept));
}

TEST_F(SpoolStoreTest, WhatWasDroppedIsNotMissedByTheNextLife) {
  {
    SpoolStore store(options(16'000));
    for (int i = 1; i <= 40; ++i) append(store, std::to_string(i));
    store.drop_oldest();
  }
  const SpoolStore store(options(16'000));
  EXPECT_EQ(store.found().missing_messages, 0u);
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

TEST_F(SpoolStoreTest, AFullDiskIsAnAnswerAndLeavesNothingBehind) {
  SpoolStore store(options());
  append(store, "1");
  const std::uint64_t before = store.bytes();
  disk_.error = ENOSPC;
  Position where;
  EXPECT_EQ(store.append(1, sample("2"), where), SpoolStore::Append::failed);
  EXPECT_THAT(store.problem(), HasSubstr("No space left"));
  EXPECT_EQ(store.bytes(), before);
  EXPECT_EQ(std::filesystem::file_size(only_segment()), before);
  disk_.error = 0;
  append(store, "3");
  EXPECT_THAT(bodies(store), ElementsAre("1", "3"));
  EXPECT_EQ(store.next_sequence(), 3u);
}

TEST_F(SpoolStoreTest, AFullDiskAtTheStartOfASegmentIsAnAnswerToo) {
  SpoolStore store(options());
  disk_.error = ENOSPC;
  Position where;
  EXPECT_EQ(store.append(1, sample("1"), where), SpoolStore::Append::failed);
  EXPECT_THAT(files(store.folder(), ".segment"), IsEmpty());
  disk_.error = 0;
  append(store, "1");
}

TEST_F(SpoolStoreTest, AlwaysMeansThatEachRecordIsOnTheDiskBeforeItIsStored) {
  SpoolStore::Options always = options();
  always.sync = Sync::always;
  SpoolStore store(always);
  append(store, "1");
  const int before = disk_.syncs;
  append(store, "2");
  EXPECT_EQ(disk_.syncs, before + 1);
  disk_.sync_error = EIO;
  Position where;
  EXPECT_EQ(store.append(1, sample("3"), where), SpoolStore::Append::failed);
  EXPECT_THAT(bodies(store), ElementsAre("1", "2"));
}

TEST_F(SpoolStoreTest, SyncPutsEveryFileOnTheDiskWhoseMessagesAreNotDoneWith) {
  SpoolStore store(options(16'000));
  for (int i = 1; i <= 40; ++i) append(store, std::to_string(i));
  const auto all = static_cast<int>(files(store.folder(), ".segment").size());
  ASSERT_GT(all, 2);
  int before = disk_.syncs;
  EXPECT_EQ(store.sync(), 0);
  EXPECT_EQ(disk_.syncs - before, all);
  before = disk_.syncs;
  EXPECT_EQ(store.sync(), 0);
  EXPECT_EQ(disk_.syncs - before, 1) << "the one that is being written";
  for (int i = 41; i <= 80; ++i) append(store, std::to_string(i));
  store.raise_mark(81);
  before = disk_.syncs;
  EXPECT_EQ(store.sync(), 0);
  EXPECT_EQ(disk_.syncs - before, 0) << "there is nothing to protect";
}

TEST_F(SpoolStoreTest, NeverMeansThatTheDiskIsNotWaitedFor) {
  SpoolStore::Options never = options(16'000);
  never.sync = Sync::never;
  SpoolStore store(never);
  for (int i = 1; i <= 40; ++i) append(store, std::to_string(i));
  EXPECT_EQ(disk_.syncs, 0);
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
