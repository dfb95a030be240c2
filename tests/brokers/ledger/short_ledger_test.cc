// Nothing is lost, in brief: about 20 s of faults for each kind of broker.
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/ledger/ledger.h"

namespace iotcloud::brokers {
namespace {

class ShortLedger : public testing::TestWithParam<std::string> {};

INSTANTIATE_TEST_SUITE_P(On, ShortLedger,
                         testing::Values("embedded", "rabbitmq", "cluster", "kafka", "replicated_kafka", "activemq"),
                         [](const auto& kind) { return kind.param; });

TEST_P(ShortLedger, BalancesWhileTheServerIsKilledAndPaused) {
  run_ledger(GetParam(), {});
}

}  // namespace
}  // namespace iotcloud::brokers
