#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/spool/store/spool_reader.h"
#include "iotcloud/brokers/spool/store/spool_store.h"
#include "iotcloud/tests/brokers/spool/spool_fixture.h"
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::brokers::spool {

/// A spool in a folder of its own, on a disk that can be full.
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
    EXPECT_THAT(all, testing::SizeIs(1));
    return all.empty() ? "" : all.front();
  }

  tests::TemporaryFolder folder_;
  TestDisk disk_;
};

}  // namespace iotcloud::brokers::spool
