#include <algorithm>
#include <chrono>
#include <map>
#include <ostream>
#include <set>
#include <tuple>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/signing/sha256.h>
#include <iotcloud/master/cli/drivers_command.h>
#include <iotcloud/master/cli/output.h>

namespace iotcloud::master::cli {

using discovery::wire::TDirection;
using discovery::wire::TSensor;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

std::int64_t wall_ms() {
  using namespace std::chrono;
  return duration_cast<milliseconds>(system_clock::now().time_since_epoch()).count();
}

template <typename T>
bool among(const std::vector<T>& all, const T& one) {
  return std::find(all.begin(), all.end(), one) != all.end();
}

/// Nothing for a driver of the original system, which puts bytes of its own there.
std::map<std::string, std::string> metadata_of(const TSensor& driver) {
  std::map<std::string, std::string> metadata;
  const auto json = Json::parse(driver.metadata, nullptr, false);
  if (!json.is_object()) return metadata;
  for (const auto& [key, value] : json.items()) {
    if (value.is_string()) metadata[key] = value.get<std::string>();
  }
  return metadata;
}

/// What an expression may ask about.
discovery::DriverRecord record_of(const TSensor& driver) {
  discovery::DriverRecord record;
  record.name = driver.name;
  record.instance = driver.sensorId;
  record.gateway = driver.siteId;
  record.state = discovery::parse_driver_state(driver.exactState);
  record.metadata = metadata_of(driver);
  return record;
}

/// Drivers in the order in which people look for them.
std::vector<TSensor> sorted_drivers(MasterClient& master) {
  auto drivers = master.drivers();
  std::sort(drivers.begin(), drivers.end(), [](const auto& a, const auto& b) {
    return std::tie(a.name, a.siteId, a.sensorId) < std::tie(b.name, b.siteId, b.sensorId);
  });
  return drivers;
}

/// Those that the command's options leave.
std::vector<TSensor> fitting_drivers(const Command& command, const discovery::Selection& where, MasterClient& master) {
  auto drivers = sorted_drivers(master);
  std::erase_if(drivers, [&](const TSensor& driver) {
    const auto begins = [&](const std::string& id) { return driver.sensorId.starts_with(id); };
    return (!command.instances.empty() && std::none_of(command.instances.begin(), command.instances.end(), begins)) ||
           (!command.gateways.empty() && !among(command.gateways, driver.siteId)) ||
           (!command.driver.empty() && command.driver != driver.name) ||
           (!command.name.empty() && command.name != driver.deployment) ||
           (!command.state.empty() && command.state != driver.exactState) ||
           (!where.everything() && !where.matches(record_of(driver)));
  });
  return drivers;
}

}  // namespace

std::string metadata_words(const TSensor& driver) {
  std::vector<std::string> words;
  for (const auto& [key, value] : metadata_of(driver)) {
    words.push_back(value.find(' ') == std::string::npos ? key + "=" + value : key + "=\"" + value + "\"");
  }
  return fmt::format("{}", fmt::join(words, " "));
}

std::string full_name(const TSensor& driver) {
  return driver.deployment.empty() ? "-" : fmt::format("{}/{}", driver.deployment, driver.index);
}

std::string plugin_words(const TSensor& driver) {
  if (driver.plugin.empty()) return "-";
  if (driver.sha256.empty()) return driver.plugin;
  return fmt::format("{} (SHA-256 {}..., {})", driver.plugin, config::short_sha256(driver.sha256),
                     driver.signedBy.empty() ? "not signed by a trusted key" : "signed by " + driver.signedBy);
}

Json to_json(const TSensor& driver) {
  Json channels = Json::array();
  for (const auto& channel : driver.channels) {
    channels.push_back({{"name", channel.name},
                        {"direction", channel.direction == TDirection::OUT ? "out" : "in"},
                        {"broker", channel.transport},
                        {"broker_url", without_password(channel.brokerUrl)},
                        {"shared", channel.grouped},
                        {"properties", channel.properties}});
  }
  return {{"instance", driver.sensorId},
          {"name", driver.deployment},
          {"index", driver.index},
          {"driver", driver.name},
          {"gateway", driver.siteId},
          {"state", driver.exactState},
          {"reason", driver.reason},
          {"since_ms", driver.sinceMs},
          {"metadata", metadata_of(driver)},
          {"channels", std::move(channels)},
          {"plugin", {{"file", driver.plugin}, {"sha256", driver.sha256}, {"signed_by", driver.signedBy}}}};
}

discovery::Selection where_of(const Command& command) {
  if (command.where.empty()) return {};
  try {
    return discovery::Selection::parse(command.where);
  } catch (const discovery::SelectionError& error) {
    throw std::invalid_argument(
        fmt::format("--where, {}\nQuote the whole expression for the shell: --where 'site == \"lab\" and battery > 20'",
                    error.what()));
  }
}

int show_drivers(const Command& command, const discovery::Selection& where, MasterClient& master, std::ostream& out) {
  const auto drivers = fitting_drivers(command, where, master);
  if (command.format == Format::table) {
    std::set<std::string> lost;
    for (const auto& gateway : master.gateways())
      if (!gateway.alive) lost.insert(gateway.siteId);
    const std::int64_t now = wall_ms();
    Rows rows;
    for (const auto& driver : drivers)
      rows.push_back({driver.sensorId, printable(full_name(driver)), printable(driver.name),
                      printable(driver.siteId) + (lost.contains(driver.siteId) ? " (lost)" : ""), driver.exactState,
                      age(driver.sinceMs, now), printable(metadata_words(driver)), printable(driver.reason)});
    print_table(out, {"INSTANCE", "NAME", "DRIVER", "GATEWAY", "STATE", "SINCE", "METADATA", "REASON"}, rows);
    return exit_ok;
  }
  Json json = Json::array();
  for (const auto& driver : drivers) json.push_back(to_json(driver));
  print_data(out, command.format, json);
  return exit_ok;
}

std::vector<std::string> fitting_ids(const Command& command, const discovery::Selection& where, MasterClient& master) {
  std::vector<std::string> ids;
  for (const auto& driver : fitting_drivers(command, where, master)) ids.push_back(driver.sensorId);
  if (ids.empty()) throw Failed("no driver instance is chosen by these options; `iotcloud drivers` takes them too");
  return ids;
}

std::vector<std::string> full_ids(const std::vector<std::string>& beginnings, MasterClient& master) {
  const auto drivers = sorted_drivers(master);
  std::vector<std::string> ids;
  for (const auto& beginning : beginnings) {
    std::vector<std::string> fitting;
    for (const auto& driver : drivers) {
      if (driver.sensorId == beginning) {
        fitting = {beginning};
        break;
      }
      if (driver.sensorId.starts_with(beginning))
        fitting.push_back(
            fmt::format("{} ({} on {})", driver.sensorId, printable(driver.name), printable(driver.siteId)));
    }
    if (fitting.size() > 1)
      throw Ambiguous(fmt::format("\"{}\" begins {} ids; give more of it:\n  {}", beginning, fitting.size(),
                                  fmt::join(fitting, "\n  ")));
    ids.push_back(fitting.empty() ? beginning : fitting.front().substr(0, fitting.front().find(' ')));
  }
  return ids;
}

}  // namespace iotcloud::master::cli
