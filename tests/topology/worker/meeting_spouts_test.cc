// Which spouts' channels must be shared out alike, because their tuples can come to one bolt.
#include <string>

#include <gtest/gtest.h>

#include <iotcloud/topology/worker/meeting_spouts.h>

namespace iotcloud::topology {
namespace {

/// Spouts `a`, `b` and `d` of one driver, and `c` of another one.
constexpr const char* spouts = R"(topology.name: t
spouts:
  a: {broker: rabbitmq, driver: robot, channel: a, fields: [data]}
  b: {broker: rabbitmq, driver: robot, channel: b, fields: [data]}
  c: {broker: rabbitmq, driver: meter, channel: c, fields: [data]}
  d: {broker: rabbitmq, driver: robot, channel: d, fields: [data]}
bolts:
)";

/// Whether two spouts have one agreement. \param bolts as in the file; each after those that feed it
bool agree(const std::string& first, const std::string& second, const std::string& bolts) {
  const auto definition = TopologyDefinition::parse(spouts + bolts, "t.yaml");
  Topology topology;
  for (const auto* components : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *components) {
      ComponentSpec& spec = topology.components.emplace_back();
      spec.id = component.id;
      for (const auto& input : component.inputs) spec.inputs.emplace_back().from = input.from;
    }
  }
  const auto agreements = agreements_by_spout(definition, topology);
  return agreements.at(first) == agreements.at(second);
}

TEST(MeetingSpouts, HaveOneAgreementIfABoltGetsTuplesOfBothAlsoThroughOthers) {
  const std::string apart = "  first: {class: X, inputs: {from: a}}\n  second: {class: X, inputs: {from: b}}\n";
  EXPECT_FALSE(agree("a", "b", apart));
  EXPECT_TRUE(agree("a", "b", apart + "  third: {class: X, inputs: [{from: first}, {from: second}]}\n"));
}

TEST(MeetingSpouts, NeedNotAgreeBecauseOfABoltThatOnlySends) {
  EXPECT_FALSE(agree("a", "b",
                     "  send: {broker: rabbitmq, driver: robot, channel: x, fields: [data, driverID], inputs: "
                     "[{from: a}, {from: b}]}\n"));
}

TEST(MeetingSpouts, OfDifferentDriversNeedNotAgreeNorConnectThoseThatTheyMeet) {
  const std::string bolts =
      "  left: {class: X, inputs: [{from: a}, {from: c}]}\n  right: {class: X, inputs: [{from: c}, {from: b}]}\n";
  EXPECT_FALSE(agree("a", "c", bolts));
  EXPECT_FALSE(agree("a", "b", bolts));
}

TEST(MeetingSpouts, AgreeAllThatMeetOneAfterAnother) {
  const std::string bolts =
      "  left: {class: X, inputs: [{from: a}, {from: b}]}\n  right: {class: X, inputs: [{from: b}, {from: d}]}\n";
  EXPECT_TRUE(agree("a", "d", bolts));
}

}  // namespace
}  // namespace iotcloud::topology
