// drivers
#include <ostream>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/master/cli/driver_verbs.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/master/cli/watch.h>
#include <iotcloud/master/listing/secret_properties.h>

namespace iotcloud::master::cli {

using discovery::DriverRecord;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

/// Why the instance is as it is, and what made it if no master ordered it.
std::string reason_words(const DriverRecord& driver) {
  if (driver.made_by.empty()) return driver.reason;
  return driver.reason.empty() ? "by " + driver.made_by : fmt::format("{}; by {}", driver.reason, driver.made_by);
}

class Drivers final : public WatchedVerb {
 public:
  Drivers()
      : WatchedVerb({"drivers", "List driver instances with their state, and why they are in it",
                     "iotcloud drivers --where 'site == \"lab\" and battery > 20'", security::Role::viewer}) {}

  void declare(CLI::App& options) override {
    WatchedVerb::declare(options);
    choice_.add_ids(options, "ids, or how they begin, or names (meter/2)");
    choice_.add_what_they_are(options, "only on these gateways");
  }

  int show(Call& call, MasterClient& master) override {
    const auto drivers = choice_.drivers(master);
    Rows rows;
    Json json = Json::array();
    if (call.format == Format::table) {
      std::set<discovery::GatewayId> lost;
      for (const auto& gateway : master.gateways())
        if (!gateway.alive) lost.insert(gateway.record.id);
      for (const auto& driver : drivers)
        rows.push_back({driver.instance, printable(full_name(driver)), printable(driver.name),
                        printable(driver.gateway) + (lost.contains(driver.gateway) ? " (lost)" : ""),
                        to_string(driver.state), age(driver.since_ms, now_ms()), printable(metadata_words(driver)),
                        printable(reason_words(driver))});
    } else {
      for (const auto& driver : drivers) json.push_back(driver_json(driver));
    }
    print(call.out, call.format, {"INSTANCE", "NAME", "DRIVER", "GATEWAY", "STATE", "SINCE", "METADATA", "REASON"},
          rows, json);
    return exit_ok;
  }

 private:
  InstanceChoice choice_;
};

}  // namespace

std::string metadata_words(const DriverRecord& driver) {
  std::vector<std::string> words;
  for (const auto& [key, value] : driver.metadata)
    words.push_back(value.find(' ') == std::string::npos ? key + "=" + value : key + "=\"" + value + "\"");
  return fmt::format("{}", fmt::join(words, " "));
}

std::string full_name(const DriverRecord& driver) {
  return driver.deployment.empty() ? "-" : fmt::format("{}/{}", driver.deployment, driver.index);
}

Json driver_json(const DriverRecord& driver) {
  Json channels = Json::array();
  for (const auto& channel : driver.channels) {
    channels.push_back({{"name", channel.name},
                        {"direction", channel.direction == discovery::Direction::out ? "out" : "in"},
                        {"broker", channel.transport},
                        {"broker_url", without_password(channel.broker_url)},
                        {"shared", channel.shared},
                        {"properties", channel.properties}});
  }
  return {{"instance", driver.instance},
          {"name", driver.deployment},
          {"index", driver.index},
          {"driver", driver.name},
          {"gateway", driver.gateway},
          {"state", to_string(driver.state)},
          {"reason", driver.reason},
          {"starts_again", driver.starts_again},
          {"made_by", driver.made_by},
          {"since_ms", driver.since_ms},
          {"metadata", driver.metadata},
          {"channels", std::move(channels)},
          {"plugin", {{"file", driver.plugin}, {"sha256", driver.sha256}, {"signed_by", driver.signed_by}}}};
}

void add_driver_verbs(Verbs& verbs) {
  verbs.add<Drivers>();
}

}  // namespace iotcloud::master::cli
