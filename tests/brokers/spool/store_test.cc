// The log on disk returns its records in order, in the same run and in the next.
#include <atomic>
#include <cerrno>
#include <chrono>
#include <filesystem>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/spool/store/spool_reader.h"
#include "iotcloud/brokers/spool/store/spool_store.h"
#include "iotcloud/tests/brokers/spool/store_fixture.h"
#include <iotcloud/config/error.h>
#include <iotcloud/tests/sync_calls.h>

namespace iotcloud::brokers::spool {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

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

TEST_F(SpoolStoreTest, TheNamesOfNewFoldersAreOnTheDiskBeforeMessagesCountAsSynced) {
  std::atomic<int> problem{0};
  const tests::SyncCalls synced([&](const std::string& path) { return path == folder_.path() ? problem.load() : 0; });
  auto deep = options();
  deep.folder = folder_ / "instance/channel";
  {
    SpoolStore store(deep);
    append(store, "a");
    EXPECT_THAT(synced.paths(), IsEmpty()) << "opening waited for the disk";
    EXPECT_EQ(store.sync(), 0);
    EXPECT_TRUE(synced.contains(folder_.path()));
    EXPECT_TRUE(synced.contains(folder_ / "instance"));
    store.raise_mark(store.next_sequence());
  }
  std::filesystem::remove(folder_ / "instance");
  problem = EIO;
  SpoolStore store(deep);
  append(store, "a");
  EXPECT_EQ(store.sync(), EIO);
  problem = 0;
  EXPECT_EQ(store.sync(), 0);
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

}  // namespace
}  // namespace iotcloud::brokers::spool
