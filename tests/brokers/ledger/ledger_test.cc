// No message is lost while the server is killed, paused and restarted: about 20 s for each kind of broker, and three
// minutes in a long run, with pauses of 10 s.
#include <gtest/gtest.h>

#include <iotcloud/tests/brokers/ledger/ledger.h>
#include <iotcloud/tests/long.h>

namespace iotcloud::brokers {
namespace {

class LedgerTest : public testing::TestWithParam<std::string> {};

INSTANTIATE_TEST_SUITE_P(On, LedgerTest,
                         testing::Values("embedded", "rabbitmq", "cluster", "kafka", "replicated_kafka", "activemq"),
                         [](const auto& kind) { return kind.param; });

TEST_P(LedgerTest, BalancesWhileTheServerIsKilledAndPaused) {
  if (tests::long_run()) {
    run_ledger(GetParam(), {std::chrono::minutes(3), std::chrono::seconds(10), std::chrono::seconds(4)});
  } else {
    run_ledger(GetParam(), {});
  }
}

}  // namespace
}  // namespace iotcloud::brokers
