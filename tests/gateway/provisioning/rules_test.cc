#include <string>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/provisioning/rules.h>

namespace iotcloud::gateway {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;

constexpr const char* good = R"(
finders:
  house: {plugin: mqtt-finder.so, properties: {url: "mqtt://10.0.0.5"}}
rules:
  meters:
    finder: house
    where: 'kind == "meter"'
    plugin: mqtt.so
    name: "meter-{id}"
    properties: {subscribe: "{topic:topic}=readings", isolation: instance}
    metadata: {model: "{model:text}"}
    grace: 10s
    most: 5
    rate: 0.5
)";

std::string refusal(std::string text, const std::string& what, const std::string& by) {
  text.replace(text.find(what), what.size(), by);
  try {
    ProvisioningRules::parse(text, "rules.yaml");
  } catch (const config::Error& e) {
    return e.what();
  }
  return "";
}

TEST(ProvisioningRules, are_read_from_a_file) {
  const auto rules = ProvisioningRules::parse(good, "rules.yaml");
  ASSERT_EQ(rules.finders.size(), 1U);
  EXPECT_EQ(rules.finders[0].plugin, "mqtt-finder.so");
  ASSERT_EQ(rules.rules.size(), 1U);
  const auto& rule = rules.rules[0];
  EXPECT_EQ(rule.grace, 10s);
  EXPECT_EQ(rule.most, 5U);
  EXPECT_EQ(rule.rate, 0.5);
  EXPECT_TRUE(rule.instance.has_places());
}

TEST(ProvisioningRules, that_are_wrong_are_refused_with_their_place_and_remedy) {
  EXPECT_THAT(refusal(good, "finder: house", "finder: hall"), HasSubstr("rules.yaml:6"));
  EXPECT_THAT(refusal(good, "finder: house", "finder: hall"), HasSubstr("no finder \"hall\""));
  EXPECT_THAT(refusal(good, "kind ==", "kind = ="), HasSubstr("where"));
  EXPECT_THAT(refusal(good, "mqtt.so", "../mqtt.so"), HasSubstr("plugin"));
  EXPECT_THAT(refusal(good, "meter-{id}", "meter"), HasSubstr("{id:name}"));
  EXPECT_THAT(refusal(good, "{topic:topic}", "{topic:any}"), HasSubstr("\"any\""));
  EXPECT_THAT(refusal(good, "isolation: instance", "network: \"{address:host}\""), HasSubstr("driver host obeys"));
  EXPECT_THAT(refusal(good, "isolation: instance", "channel.readings.broker: \"{x}\""), HasSubstr("driver host obeys"));
  EXPECT_THAT(refusal(good, "most: 5", "most: 0"), HasSubstr("most"));
  EXPECT_THAT(refusal(good, "rate: 0.5", "ratio: 2"), HasSubstr("ratio"));
  EXPECT_THAT(refusal(good, "grace: 10s", "grace: 10"), HasSubstr("grace"));
}

}  // namespace
}  // namespace iotcloud::gateway
