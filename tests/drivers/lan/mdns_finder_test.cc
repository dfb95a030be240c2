#include <atomic>
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/drivers/lan/mdns_finder.h>
#include <iotcloud/tests/drivers/lan/dns_answer.h>
#include <iotcloud/tests/drivers/lan/responder.h>
#include <iotcloud/tests/drivers/stream/until.h>

namespace iotcloud::drivers::lan {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::IsSupersetOf;
using testing::MockInstance;

Descriptor finder_plugin() {
  return describe<MdnsFinder>("mdns_finder", "test");
}

TEST(MdnsFinder, finds_services_and_sees_that_they_are_gone) {
  std::atomic<bool> there{true};
  Responder machines([&](const std::string& question) {
    EXPECT_THAT(question, HasSubstr(name({"_http", "_tcp", "local"})));
    return there ? answer("Front Door.1") : "";
  });
  MockInstance finder(finder_plugin(), {{"services", "_http._tcp"}, {"to", machines.address()}, {"period_s", "5"}});
  ASSERT_TRUE(finder.start()) << finder.error();
  EXPECT_TRUE(finder.host().sees());
  ASSERT_TRUE(until(finder, [&] { return finder.host().found().size() == 1; }));
  EXPECT_THAT(finder.host().found().begin()->second, IsSupersetOf(PropertyMap{{"kind", "mdns"},
                                                                              {"service", "_http._tcp"},
                                                                              {"id", "Front Door.1"},
                                                                              {"address", "10.0.0.9"},
                                                                              {"host", "camera.local"},
                                                                              {"port", "8080"},
                                                                              {"txt.path", "/cam"},
                                                                              {"txt.model", "X-10"}}));
  there = false;
  finder.host().advance(15s);
  EXPECT_EQ(finder.host().found().size(), 1U);
  finder.host().advance(5s);
  EXPECT_THAT(finder.host().found(), IsEmpty()) << "it has not answered three times in a row";
}

TEST(MdnsFinder, passes_over_what_it_cannot_read) {
  const std::string good = answer("a");
  for (const std::string& bad :
       {std::string("x"), good.substr(0, 40), good.substr(0, good.size() - 2), answer("gone", 0)}) {
    std::atomic<int> asked{0};
    Responder machines([&](const std::string&) {
      ++asked;
      return bad;
    });
    MockInstance finder(finder_plugin(), {{"services", "_http._tcp"}, {"to", machines.address()}});
    ASSERT_TRUE(finder.start()) << finder.error();
    ASSERT_GT(finder.host().poll_descriptors(60s), 0U);
    EXPECT_THAT(finder.host().found(), IsEmpty());
  }
}

TEST(MdnsFinder, refuses_names_that_are_no_service) {
  for (const char* bad : {"", "http", "_http", "_http._tcp.local", "_a,_b"}) {
    MockInstance finder(finder_plugin(), {{"services", bad}});
    EXPECT_FALSE(finder.start()) << bad;
  }
}

}  // namespace
}  // namespace iotcloud::drivers::lan
