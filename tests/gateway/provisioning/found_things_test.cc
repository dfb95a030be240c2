#include <string>

#include <gmock/gmock.h>

#include <iotcloud/gateway/host/found_things.h>
#include <iotcloud/gateway/host/protocol.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::gateway {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

FoundThing thing(const std::string& key, const std::string& value = "x") {
  return {key, {{"a", value}}};
}

TEST(FoundThings, count_what_is_not_taken) {
  FoundThings things;
  EXPECT_EQ(things.found(thing("1")), "");
  EXPECT_EQ(things.refused(), 0U);
  EXPECT_NE(things.found(thing("")), "");
  EXPECT_NE(things.found(thing("2", std::string(20'000, 'x'))), "");
  EXPECT_EQ(things.refused(), 2U);
}

TEST(FoundThings, are_reported_whole_first_and_then_as_they_change) {
  FoundThings things;
  things.sight(true);
  EXPECT_EQ(things.found(thing("1")), "");
  EXPECT_EQ(things.found(thing("2")), "");
  auto reports = things.take("eye"_instance, false);
  ASSERT_EQ(reports.size(), 1U);
  EXPECT_TRUE(reports[0].whole);
  EXPECT_TRUE(reports[0].sees);
  EXPECT_THAT(reports[0].found, ElementsAre(thing("1"), thing("2")));
  EXPECT_FALSE(things.changed());
  things.found(thing("1"));
  EXPECT_FALSE(things.changed()) << "as it was";
  things.found(thing("1", "y"));
  things.gone("2");
  things.gone("3");
  reports = things.take("eye"_instance, false);
  ASSERT_EQ(reports.size(), 1U);
  EXPECT_FALSE(reports[0].whole);
  EXPECT_THAT(reports[0].found, ElementsAre(thing("1", "y")));
  EXPECT_THAT(reports[0].gone, ElementsAre("2"));
  reports = things.take("eye"_instance, true);
  ASSERT_EQ(reports.size(), 1U);
  EXPECT_TRUE(reports[0].whole);
  EXPECT_THAT(reports[0].found, ElementsAre(thing("1", "y")));
}

TEST(FoundThings, are_void_when_their_finder_sees_again) {
  FoundThings things;
  things.sight(true);
  things.found(thing("1"));
  things.take("eye"_instance, false);
  things.sight(false);
  auto reports = things.take("eye"_instance, false);
  ASSERT_EQ(reports.size(), 1U);
  EXPECT_FALSE(reports[0].sees);
  things.sight(true);
  things.found(thing("2"));
  reports = things.take("eye"_instance, false);
  ASSERT_EQ(reports.size(), 1U);
  EXPECT_TRUE(reports[0].whole);
  EXPECT_THAT(reports[0].found, ElementsAre(thing("2")));
}

TEST(FoundThings, of_an_instance_that_is_no_finder_are_no_report) {
  FoundThings things;
  EXPECT_FALSE(things.changed());
  EXPECT_THAT(things.take("eye"_instance, true), IsEmpty());
}

TEST(FoundThings, have_limits) {
  FoundThings things;
  EXPECT_THAT(things.found(thing("")), HasSubstr("key"));
  EXPECT_THAT(things.found(thing(std::string(300, 'k'))), HasSubstr("key"));
  EXPECT_THAT(things.found({"1", {}}), HasSubstr("attributes"));
  EXPECT_THAT(things.found(thing("1", std::string(20'000, 'v'))), HasSubstr("bytes"));
  for (int i = 0; i < 10'000; ++i) ASSERT_EQ(things.found(thing(std::to_string(i), std::string(500, 'v'))), "");
  EXPECT_THAT(things.found(thing("more")), HasSubstr("10000"));
  EXPECT_EQ(things.found(thing("7", "changed")), "");
  const auto reports = things.take("eye"_instance, false);
  EXPECT_GT(reports.size(), 3U) << "of a megabyte each";
  std::size_t told = 0;
  for (const auto& report : reports) told += report.found.size();
  EXPECT_EQ(told, 10'000U);
  EXPECT_TRUE(reports[0].whole);
  EXPECT_FALSE(reports[1].whole);
}

TEST(FoundThings, cross_the_protocol) {
  protocol::FoundMessage message{{"eye"_instance, true, true, {thing("1")}, {"2"}}};
  const auto frame = encode(protocol::HostReport(message));
  const auto report = protocol::decode_report(frame.substr(4));
  const auto& came = std::get<protocol::FoundMessage>(report).report;
  EXPECT_EQ(came.finder, "eye"_instance);
  EXPECT_TRUE(came.whole);
  EXPECT_THAT(came.found, ElementsAre(thing("1")));
  EXPECT_THAT(came.gone, ElementsAre("2"));
}

}  // namespace
}  // namespace iotcloud::gateway
