#include <atomic>
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/drivers/lan/onvif_finder.h>
#include <iotcloud/tests/drivers/lan/probe_match.h>
#include <iotcloud/tests/drivers/lan/responder.h>
#include <iotcloud/tests/drivers/stream/until.h>

namespace iotcloud::drivers::lan {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::MockInstance;
using ::testing::Pair;

std::string id_of(const std::string& probe) {
  const auto begin = probe.find("MessageID>") + 10;
  return probe.substr(begin, probe.find('<', begin) - begin);
}

Descriptor finder_plugin() {
  return describe<OnvifFinder>("onvif_finder", "test");
}

TEST(OnvifFinder, finds_cameras_and_sees_that_they_are_gone) {
  std::atomic<bool> there{true};
  Responder camera([&](const std::string& probe) {
    EXPECT_THAT(probe, HasSubstr("NetworkVideoTransmitter"));
    return there ? probe_match(id_of(probe)) : "";
  });
  MockInstance finder(finder_plugin(), {{"to", camera.address()}, {"period_s", "5"}});
  ASSERT_TRUE(finder.start()) << finder.error();
  ASSERT_TRUE(until(finder, [&] { return finder.host().found().size() == 1; }));
  EXPECT_THAT(finder.host().found(),
              ElementsAre(Pair("onvif 7-8-9", PropertyMap{{"kind", "onvif"},
                                                          {"id", "7-8-9"},
                                                          {"address", "127.0.0.1"},
                                                          {"service", "http://10.0.0.9/onvif/device_service"},
                                                          {"name", "Front Door"},
                                                          {"model", "X10"},
                                                          {"profile", "Streaming"},
                                                          {"location", "hall"}})));
  there = false;
  finder.host().advance(20s);
  EXPECT_THAT(finder.host().found(), IsEmpty());
}

TEST(OnvifFinder, passes_over_answers_to_nobodys_questions_and_what_is_no_answer) {
  for (const std::string& bad : {probe_match("urn:uuid:0"), probe_match(""), std::string("<a>"), std::string("no xml"),
                                 std::string("<!DOCTYPE x [<!ENTITY e SYSTEM \"file:///etc/passwd\">]><x>&e;</x>")}) {
    Responder stranger([&](const std::string&) { return bad; });
    MockInstance finder(finder_plugin(), {{"to", stranger.address()}});
    ASSERT_TRUE(finder.start()) << finder.error();
    ASSERT_GT(finder.host().poll_descriptors(60s), 0U);
    EXPECT_THAT(finder.host().found(), IsEmpty());
    EXPECT_EQ(finder.host().logged_count("is passed over"), 1U);
  }
}

TEST(OnvifFinder, does_not_see_when_nobody_can_be_asked) {
  MockInstance finder(finder_plugin(), {{"to", "255.255.255.255:9"}});  // which takes a right that it has not
  ASSERT_TRUE(finder.start()) << finder.error();
  EXPECT_FALSE(finder.host().sees());
  EXPECT_THAT(finder.host().metadata()["problem"], HasSubstr("255.255.255.255"));
}

}  // namespace
}  // namespace iotcloud::drivers::lan
