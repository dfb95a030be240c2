// Nothing is lost: three minutes under load while the server is killed, paused for 10 s and started again.
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/ledger/ledger.h"

namespace iotcloud::brokers {
namespace {

class LongLedger : public testing::TestWithParam<std::string> {};

INSTANTIATE_TEST_SUITE_P(On, LongLedger,
                         testing::Values("embedded", "rabbitmq", "cluster", "kafka", "replicated_kafka", "activemq"),
                         [](const auto& kind) { return kind.param; });

TEST_P(LongLedger, BalancesWhileTheServerIsKilledAndPaused) {
  run_ledger(GetParam(), {std::chrono::minutes(3), std::chrono::seconds(10), std::chrono::seconds(4)});
}

}  // namespace
}  // namespace iotcloud::brokers
