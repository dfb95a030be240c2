#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/lease.h>

namespace iotcloud::gateway {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;
using Properties = std::map<std::string, std::string>;

std::string problem(const Properties& properties, std::chrono::milliseconds session = 10s) {
  try {
    check_lease(properties, session);
    return "";
  } catch (const config::Error& e) {
    return e.what();
  }
}

TEST(Lease, AnInstanceHasNoneUnlessItsDeploymentStopsOnAPartition) {
  EXPECT_EQ(lease_of({}), std::nullopt);
  EXPECT_EQ(lease_of({{"on_partition", "continue"}}), std::nullopt);
  EXPECT_EQ(lease_of({{"on_partition", "stop"}, {"lease", "30s"}}), 30s);
}

TEST(Lease, SaysWhatIsWrongWithIt) {
  EXPECT_THAT(problem({{"on_partition", "halt"}}), HasSubstr("give stop or continue"));
  EXPECT_THAT(problem({{"on_partition", "stop"}}), HasSubstr("needs the property lease"));
  EXPECT_THAT(problem({{"lease", "30s"}}), HasSubstr("needs on_partition=stop"));
  EXPECT_THAT(problem({{"on_partition", "continue"}, {"lease", "30s"}}), HasSubstr("needs on_partition=stop"));
  EXPECT_THAT(problem({{"on_partition", "stop"}, {"lease", "soon"}}), HasSubstr("is no time"));
}

TEST(Lease, IsNotShorterThanTheGatewaysSession) {
  EXPECT_THAT(problem({{"on_partition", "stop"}, {"lease", "9s"}}), HasSubstr("give at least that"));
  EXPECT_EQ(problem({{"on_partition", "stop"}, {"lease", "10s"}}), "");
}

TEST(Lease, RunsOutWhenNothingConfirmsIt) {
  const config::Clock::Instant start{1h};
  LeaseConfirmation confirmation;
  EXPECT_EQ(confirmation.left(30s, start), 0s) << "nothing was confirmed yet";
  confirmation.renew(start);
  EXPECT_EQ(confirmation.left(30s, start + 29s), 1s);
  EXPECT_EQ(confirmation.left(30s, start + 30s), 0s);
  EXPECT_EQ(confirmation.left(30s, start + 2h), 0s);
  confirmation.renew(start + 20s);
  confirmation.renew(start + 10s);  // a confirmation that was under way for long
  EXPECT_EQ(confirmation.left(30s, start + 45s), 5s);
}

}  // namespace
}  // namespace iotcloud::gateway
