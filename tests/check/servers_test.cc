// The probes of brokers and registry against real servers: there, and killed.
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/check/probes.h>
#include <iotcloud/tests/servers/private_server.h>

namespace iotcloud::check {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

/// What the only finding says.
std::string only(const Findings& findings) {
  if (findings.size() != 1) return std::to_string(findings.size()) + " findings";
  return std::string(word_of(findings[0].state)) + ": " + findings[0].says + "; " + findings[0].mend;
}

class BrokerProbe : public ::testing::TestWithParam<const char*> {
 protected:
  static std::string probe(const std::string& url, std::chrono::milliseconds limit) {
    Machine machine{.file = "gateway.yaml", .kind = "gateway"};
    machine.brokers["main"].urls = {url};
    Findings findings;
    check_brokers(machine, limit, findings);
    return only(findings);
  }
};

TEST_P(BrokerProbe, SaysWhetherABrokerTakesConnections) {
  tests::PrivateServer server(std::string(GetParam()) + ".py");
  EXPECT_THAT(probe(server.url(), 60s), HasSubstr("ok: takes connections"));
  server.kill();
  EXPECT_THAT(probe(server.url(), 2s), AllOf(HasSubstr("wrong: "), HasSubstr("start it, or correct brokers.main")));
}

INSTANTIATE_TEST_SUITE_P(Of, BrokerProbe, ::testing::Values("rabbitmq", "kafka", "activemq"),
                         [](const auto& of) { return std::string(of.param); });

TEST(RegistryProbe, SaysWhetherARegistryAnswers) {
  tests::PrivateServer server("zookeeper.py");
  Machine machine{.file = "gateway.yaml", .kind = "gateway"};
  machine.registry.url = server.url();
  machine.registry.open = true;
  Findings findings;
  check_registry(machine, 60s, findings);
  EXPECT_THAT(only(findings), HasSubstr("ok: answers"));
}

}  // namespace
}  // namespace iotcloud::check
