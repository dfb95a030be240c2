// The log on disk: its limit, a disk that is full, and when the files are on the disk.
#include <cstdint>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/spool/store/spool_store.h"
#include "iotcloud/tests/brokers/spool/store_fixture.h"

namespace iotcloud::brokers::spool {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

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

TEST_F(SpoolStoreTest, AFullDiskIsAnAnswerAndLeavesNothingBehind) {
  SpoolStore store(options());
  append(store, "1");
  const std::uint64_t before = store.bytes();
  disk_.error = ENOSPC;
  Position where;
  EXPECT_EQ(store.append(1, sample("2"), where), SpoolStore::Append::disk_full);
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
  EXPECT_EQ(store.append(1, sample("1"), where), SpoolStore::Append::disk_full);
  EXPECT_THAT(files(store.folder(), ".segment"), IsEmpty());
  disk_.error = 0;
  append(store, "1");
}

TEST_F(SpoolStoreTest, AppendNeverWaitsForTheDisk) {
  SpoolStore store(options(16'000));
  for (int i = 1; i <= 40; ++i) append(store, std::to_string(i));
  ASSERT_GT(files(store.folder(), ".segment").size(), 2U) << "files are made and completed";
  EXPECT_EQ(disk_.syncs, 0);
}

TEST_F(SpoolStoreTest, SyncPutsEveryFileOnTheDiskWhoseMessagesAreNotDoneWith) {
  SpoolStore store(options(16'000));
  for (int i = 1; i <= 40; ++i) append(store, std::to_string(i));
  const auto all = static_cast<int>(files(store.folder(), ".segment").size());
  ASSERT_GT(all, 2);
  int before = disk_.syncs;
  EXPECT_EQ(store.sync(), 0);
  EXPECT_EQ(disk_.syncs - before, all + 1) << "and the folder, which has new files";
  before = disk_.syncs;
  EXPECT_EQ(store.sync(), 0);
  EXPECT_EQ(disk_.syncs - before, 1) << "the one that is being written";
  for (int i = 41; i <= 80; ++i) append(store, std::to_string(i));
  store.raise_mark(81);
  before = disk_.syncs;
  EXPECT_EQ(store.sync(), 0);
  EXPECT_EQ(disk_.syncs - before, 0) << "there is nothing to protect";
}

TEST_F(SpoolStoreTest, WhatCouldNotBePutOnTheDiskIsTriedAgain) {
  SpoolStore store(options(16'000));
  for (int i = 1; i <= 40; ++i) append(store, std::to_string(i));
  const auto all = static_cast<int>(files(store.folder(), ".segment").size());
  disk_.sync_error = EIO;
  EXPECT_EQ(store.sync(), EIO);
  disk_.sync_error = 0;
  const int before = disk_.syncs;
  EXPECT_EQ(store.sync(), 0);
  EXPECT_EQ(disk_.syncs - before, all + 1);
}

}  // namespace
}  // namespace iotcloud::brokers::spool
