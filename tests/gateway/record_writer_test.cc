// Which records of an instance are in the registry while its driver's name becomes known, and after a restart.
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/gateway/record_writer.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/discovery/passing_registry.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::gateway {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

/// A registry that removes nothing while `refusing`.
class KeepingRegistry final : public tests::PassingRegistry {
 public:
  using PassingRegistry::PassingRegistry;
  bool refusing = false;

  bool remove(const std::string& path, std::int64_t version, const Fence& fence) override {
    if (refusing) throw discovery::RegistryError(discovery::RegistryErrorCode::away, "refused: " + path);
    return PassingRegistry::remove(path, version, fence);
  }
};

class RecordWriterTest : public testing::Test {
 protected:
  RecordWriterTest() : registry_(discovery::make_registry({.url = "embedded://record-writer-test"})) {
    EXPECT_TRUE(tests::eventually([&] { return registry_.session() == discovery::SessionState::connected; }));
  }

  static discovery::DriverRecord record(const std::string& driver) {
    discovery::DriverRecord record;
    record.name = discovery::DriverName(driver);
    record.instance = "a"_instance;
    record.gateway = "gw"_gateway;
    return record;
  }
  std::vector<std::string> names() {
    std::vector<std::string> names;
    for (const auto& found : discovery::list_drivers(registry_, paths_)) names.push_back(found.name.str());
    return names;
  }

  const discovery::Paths paths_;
  KeepingRegistry registry_;
  RecordWriter writer_{registry_, paths_};
};

TEST_F(RecordWriterTest, ADriverWhoseNameBecomesKnownHasOneRecord) {
  writer_.resume();
  writer_.put(record("plugin"));
  EXPECT_THAT(names(), ElementsAre("plugin"));
  writer_.put(record("driver"));
  EXPECT_THAT(names(), ElementsAre("driver"));
  writer_.erase("driver"_driver, "a"_instance);
  EXPECT_THAT(names(), IsEmpty());
}

TEST_F(RecordWriterTest, ANameThatBecomesKnownWhileNothingIsWrittenLeavesNoRecordUnderTheFormerOne) {
  writer_.resume();
  writer_.put(record("plugin"));
  writer_.pause();
  writer_.put(record("driver"));
  writer_.resume();
  EXPECT_THAT(names(), ElementsAre("driver"));
  writer_.erase("driver"_driver, "a"_instance);
  EXPECT_THAT(names(), IsEmpty());
}

TEST_F(RecordWriterTest, ARecordUnderTheFormerNameThatCouldNotBeRemovedIsRemovedLater) {
  writer_.resume();
  writer_.put(record("plugin"));
  registry_.refusing = true;
  writer_.put(record("driver"));
  registry_.refusing = false;
  EXPECT_TRUE(writer_.flush());
  EXPECT_THAT(names(), ElementsAre("driver"));
}

TEST_F(RecordWriterTest, ARecordUnderTheFormerNameThatCannotBeRemovedDoesNotKeepTheNewOneAway) {
  writer_.resume();
  writer_.put(record("plugin"));
  registry_.refusing = true;
  writer_.put(record("driver"));
  EXPECT_THAT(names(), ElementsAre("driver", "plugin"));
  const auto version = [&] { return registry_.get(paths_.instance("driver"_driver, "a"_instance))->version; };
  const auto before = version();
  EXPECT_FALSE(writer_.flush());
  EXPECT_EQ(version(), before) << "only the removal is tried again";
}

TEST_F(RecordWriterTest, AnInstanceThatComesBackUnderAnotherNameBeforeAnythingIsWrittenHasItsChannels) {
  const auto active = [](const std::string& driver) {
    auto with_channel = record(driver);
    with_channel.state = discovery::DriverState::active;
    with_channel.channels.emplace_back().name = "data";
    return with_channel;
  };
  writer_.resume();
  writer_.put(active("plugin"));
  writer_.pause();
  writer_.erase("plugin"_driver, "a"_instance);
  writer_.put(active("driver"));
  writer_.resume();
  EXPECT_THAT(names(), ElementsAre("driver"));
  EXPECT_TRUE(registry_.get(paths_.channel("driver"_driver, "a"_instance, "data")));
}

TEST_F(RecordWriterTest, ARecordOfTheProcessBeforeGoesWithTheInstance) {
  discovery::put(registry_, paths_.instance("plugin"_driver, "a"_instance), encode(record("plugin")));
  writer_.put(record("driver"));
  writer_.found("plugin"_driver, "a"_instance);
  writer_.resume();
  EXPECT_THAT(names(), ElementsAre("driver"));
  writer_.erase("driver"_driver, "a"_instance);
  EXPECT_THAT(names(), IsEmpty());
}

TEST_F(RecordWriterTest, ARecordOfTheProcessBeforeStaysUntilItsInstanceIsKnown) {
  discovery::put(registry_, paths_.instance("plugin"_driver, "a"_instance), encode(record("plugin")));
  writer_.found("plugin"_driver, "a"_instance);
  writer_.resume();
  EXPECT_THAT(names(), ElementsAre("plugin"));
  writer_.put(record("driver"));
  EXPECT_THAT(names(), ElementsAre("driver"));
}

}  // namespace
}  // namespace iotcloud::gateway
