// What is refused here is what a driver host refuses: the two tables are written twice, since a master uses nothing of
// a gateway.
#include <algorithm>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/channel_plan.h>
#include <iotcloud/master/cli/fleet/channel_options.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::master::cli {
namespace {

using testing::HasSubstr;

/// What a driver host says of the properties of an instance with a channel "data"; empty: it takes them.
std::string host_says(const std::map<std::string, std::string>& properties) {
  gateway::InstanceSpec spec;
  spec.order.instance = "0a1b"_instance;
  spec.order.properties = properties;
  spec.brokers = {{"rabbitmq", "rabbitmq", {}, {"amqp://own"}, {"amqp://shared"}}};
  drivers::ChannelSpec channel;
  channel.name = "data";
  try {
    plan_channels("gw1"_gateway, "meter"_driver, spec, {channel});
    return "";
  } catch (const config::Error& e) {
    return e.what();
  }
}

bool host_takes(const std::string& option, const std::string& value) {
  std::map<std::string, std::string> properties{{channel_property("data", option), value}};
  if (option.starts_with("spool_")) properties[channel_property("data", "when_full")] = "spool";
  return host_says(properties).empty();
}

TEST(ChannelOptions, AreThoseOfADriverHostWithItsValues) {
  for (const auto& option : channel_options()) {
    bool taken = false;
    for (const char* value : {"-1",
                              "0",
                              "1",
                              "9",
                              "10",
                              "100",
                              "65535",
                              "65536",
                              "1000000000",
                              "1000000001",
                              "1125899906842624",
                              "1125899906842625",
                              "1.5",
                              "many",
                              "true",
                              "false",
                              "yes",
                              "keep_newest",
                              "block",
                              "spool",
                              "drop_oldest",
                              "never",
                              "interval",
                              "always",
                              "java",
                              "rabbitmq"}) {
      if (option == "broker" && std::string(value) != "rabbitmq") continue;  // only the gateway knows its brokers
      EXPECT_EQ(channel_option_problem(option, value).empty(), host_takes(option, value)) << option << "=" << value;
      taken = taken || host_takes(option, value);
    }
    EXPECT_TRUE(taken) << "a driver host knows no option " << option;
  }
}

TEST(ChannelOptions, NoneOfADriverHostIsMissing) {
  // It lists all of them when none is near what was said.
  const auto text = host_says({{"channel.data.zzzzzzzzzz", "1"}});
  const auto list = text.substr(text.find("they are "));
  for (const auto& option : channel_options()) EXPECT_THAT(list, HasSubstr(option));
  EXPECT_EQ(std::count(list.begin(), list.end(), ',') + 1, static_cast<std::ptrdiff_t>(channel_options().size()))
      << text;
}

TEST(ChannelOptions, ASettingNamesChannelAndOption) {
  EXPECT_EQ(channel_setting_problem("my.data.priority", "5"), "");
  EXPECT_THAT(channel_setting_problem("priority", "5"), HasSubstr("CHANNEL.OPTION"));
  EXPECT_THAT(channel_setting_problem(".priority", "5"), HasSubstr("CHANNEL.OPTION"));
  EXPECT_THAT(channel_setting_problem("data.", "5"), HasSubstr("no option"));
}

}  // namespace
}  // namespace iotcloud::master::cli
