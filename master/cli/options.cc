#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <tuple>
#include <utility>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/driver_verbs.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/output.h>

namespace iotcloud::master::cli {

using discovery::DriverRecord;
using std::chrono::milliseconds;

namespace {

template <typename T>
bool among(const std::vector<T>& all, const T& one) {
  return std::find(all.begin(), all.end(), one) != all.end();
}

discovery::Selection selection_of(const std::string& where) {
  if (where.empty()) return {};
  try {
    return discovery::Selection::parse(where);
  } catch (const discovery::SelectionError& error) {
    throw std::invalid_argument(
        fmt::format("--where, {}\nQuote the whole expression for the shell: --where 'site == \"lab\" and battery > 20'",
                    error.what()));
  }
}

/// The drivers' records, sorted by driver, gateway and id.
std::vector<DriverRecord> sorted_drivers(MasterClient& master) {
  auto drivers = master.drivers();
  std::sort(drivers.begin(), drivers.end(), [](const auto& a, const auto& b) {
    return std::tie(a.name, a.gateway, a.instance) < std::tie(b.name, b.gateway, b.instance);
  });
  return drivers;
}

/// Adds what is ordered and has no record, because its gateway has not followed the order yet: it is lost or frozen,
/// say.
void add_not_taken_up(std::vector<DriverRecord>& drivers, const std::vector<ListedOrder>& orders) {
  std::set<discovery::InstanceId> known;
  for (const auto& driver : drivers) known.insert(driver.instance);
  for (const auto& placed : orders) {
    if (known.contains(placed.order.instance)) continue;
    DriverRecord record;
    record.name = placed.order.driver;
    record.instance = placed.order.instance;
    record.gateway = placed.gateway;
    record.deployment = placed.order.name;
    record.index = placed.order.index;
    record.state = discovery::DriverState::ordered;
    record.metadata = placed.order.metadata;
    drivers.push_back(std::move(record));
  }
}

/// Whether the word is the instance's name as `iotcloud drivers` shows it ("meter/2"), or that of its deployment
/// ("meter").
bool is_named(const DriverRecord& driver, const std::string& word) {
  return !driver.deployment.empty() && (word == driver.deployment || word == full_name(driver));
}

/// The instances that a word means: that with this id, or those with this name, or those whose ids begin with it.
std::vector<const DriverRecord*> meant(const std::string& word, const std::vector<DriverRecord>& drivers) {
  std::vector<const DriverRecord*> named, beginning;
  for (const auto& driver : drivers) {
    if (driver.instance == word) return {&driver};
    if (is_named(driver, word)) named.push_back(&driver);
    if (driver.instance.str().starts_with(word)) beginning.push_back(&driver);
  }
  return named.empty() ? beginning : named;
}

discovery::InstanceId completed(const std::string& word, const std::vector<DriverRecord>& drivers) {
  const auto found = meant(word, drivers);
  if (found.empty()) return discovery::InstanceId(word);
  if (found.size() == 1) return found.front()->instance;
  std::vector<std::string> lines;
  for (const auto* driver : found) {
    lines.push_back(fmt::format("{} ({}{} on {})", driver->instance, printable(driver->name),
                                driver->deployment.empty() ? "" : " " + printable(full_name(*driver)),
                                printable(driver->gateway)));
  }
  if (is_named(*found.front(), word)) {
    throw AmbiguousId(
        fmt::format("\"{}\" is the name of {} instances; give an id, or say --name for all of them:\n  {}", word,
                    found.size(), fmt::join(lines, "\n  ")));
  }
  throw AmbiguousId(
      fmt::format("\"{}\" begins {} ids; give more of it:\n  {}", word, found.size(), fmt::join(lines, "\n  ")));
}

constexpr const char* not_both = "give ids, or --where, --name, --driver, --state or --all, not both";

}  // namespace

std::map<std::string, std::string> pairs(const std::vector<std::string>& words, const char* option) {
  std::map<std::string, std::string> out;
  for (const auto& word : words) {
    const auto equals = word.find('=');
    if (equals == 0 || equals == std::string::npos)
      throw CLI::ValidationError(option, "\"" + word + "\" is not of the form NAME=VALUE");
    if (!out.emplace(word.substr(0, equals), word.substr(equals + 1)).second)
      throw CLI::ValidationError(option, word.substr(0, equals) + " is given twice");
  }
  return out;
}

CLI::Option& add_seconds(CLI::App& options, const char* name, milliseconds& into, double least, double longest,
                         const char* what) {
  return *options
              .add_option_function<double>(
                  name, [&into](double seconds) { into = milliseconds(static_cast<std::int64_t>(seconds * 1000)); },
                  what)
              ->check(CLI::Range(least, longest))
              ->type_name("SECONDS");
}

CLI::Option& add_gateways(CLI::App& options, std::vector<discovery::GatewayId>& gateways, const char* what) {
  return *options.add_option("-g,--gateway", gateways, what)
              ->delimiter(',')
              ->allow_extra_args(false)
              ->type_name("GATEWAY");
}

void add_wait(CLI::App& options, WaitLimit& wait, const char* name, const char* what) {
  options
      .add_option_function<double>(
          name, [&wait](double seconds) { wait = milliseconds(static_cast<std::int64_t>(seconds * 1000)); }, what)
      ->check(CLI::Range(0.001, 600.0))
      ->type_name("SECONDS");
}

void add_settle(CLI::App& options, milliseconds& settle) {
  settle = milliseconds{1'000};
  add_seconds(options, "--settle", settle, 0.0, 600.0,
              "seconds that the instances of a step must stay up before the next step")
      .default_str("1");
}

CLI::Option& add_plugin(CLI::App& options, std::string& plugin) {
  return *options
              .add_option("--plugin", plugin,
                          "a name (turtle.so): a file in the gateways' plugin folder; a path, with a slash "
                          "(./turtle.so): a file of "
                          "this machine, which is sent with its signature (./turtle.so.sig)")
              ->type_name("FILE");
}

void InstanceChoice::add_ids(CLI::App& options, const char* what) {
  options.add_option("ID", instances, what);
}

void InstanceChoice::add_what_they_are(CLI::App& options, const char* gateways_what) {
  add_gateways(options, gateways, gateways_what);
  options.add_option("--driver", driver, "only of this driver")->type_name("DRIVER");
  options.add_option("--name", name, "only of the deployment of this name")->type_name("NAME");
  options.add_option("--state", state, "only in this state")
      ->check(
          CLI::IsMember({"deployed", "starting", "active", "stopping", "inactive", "failed", "undeployed", "ordered"}))
      ->type_name("STATE");
  options
      .add_option(
          "--where", where,
          "only those for which it holds: site == \"lab\" and battery > 20 and within(location, 39.17, -86.52, 500 m)")
      ->type_name("EXPRESSION")
      ->check(CLI::Validator([](std::string& text) { return text.empty() ? "it is empty" : ""; }, ""));
}

bool InstanceChoice::has_conditions() const {
  return all || !name.empty() || !driver.empty() || !state.empty() || !where.empty();
}

void InstanceChoice::check_order() const {
  if (instances.empty() && !has_conditions())
    throw CLI::RequiredError("ID, or --where, --name, --driver, --state or --all,");
  // Words after -g may be gateways: with_all_gateways() finds out.
  if (!instances.empty() && gateways.empty() && has_conditions()) throw CLI::ValidationError("ID", not_both);
}

InstanceChoice InstanceChoice::with_all_gateways(MasterClient& master) const {
  if (gateways.empty() || instances.empty()) return *this;
  InstanceChoice choice = *this;
  choice.instances.clear();
  const auto known = master.gateways();
  for (const auto& word : instances) {
    const bool is_gateway =
        std::any_of(known.begin(), known.end(), [&](const auto& gateway) { return gateway.record.id == word; });
    if (is_gateway) {
      choice.gateways.emplace_back(word);
    } else if (has_conditions()) {
      throw RequestFailed(fmt::format("\"{}\" is no gateway: {}", word, not_both));
    } else {
      choice.instances.push_back(word);
    }
  }
  return choice;
}

std::vector<DriverRecord> InstanceChoice::drivers(MasterClient& master) const {
  const auto selection = selection_of(where);
  return with_all_gateways(master).chosen(sorted_drivers(master), selection);
}

std::vector<DriverRecord> InstanceChoice::chosen(std::vector<DriverRecord> drivers,
                                                 const discovery::Selection& selection) const {
  std::set<discovery::InstanceId> wanted;
  for (const auto& word : instances) {
    for (const auto* one : meant(word, drivers)) wanted.insert(one->instance);
  }
  std::erase_if(drivers, [&](const DriverRecord& one) {
    return (!instances.empty() && !wanted.contains(one.instance)) ||
           (!gateways.empty() && !among(gateways, one.gateway)) || (!driver.empty() && driver != one.name) ||
           (!name.empty() && name != one.deployment) || (!state.empty() && state != to_string(one.state)) ||
           !selection.matches(one);
  });
  return drivers;
}

std::vector<discovery::InstanceId> InstanceChoice::ids(MasterClient& master) const {
  if (instances.empty() && !has_conditions())
    throw RequestFailed("an order for all instances of gateways takes --all, too");
  std::vector<discovery::InstanceId> ids;
  if (!instances.empty()) {
    auto all_drivers = sorted_drivers(master);
    // Only the beginning of an id is completed by the orders, too. Viewers may not list them: with whole ids the master
    // refuses the verb that they called, not the listing.
    const bool whole = std::all_of(instances.begin(), instances.end(), [&](const std::string& word) {
      return std::any_of(all_drivers.begin(), all_drivers.end(),
                         [&](const DriverRecord& one) { return one.instance == word; });
    });
    if (!whole) add_not_taken_up(all_drivers, master.orders());
    for (const auto& beginning : instances) ids.push_back(completed(beginning, all_drivers));
    return ids;
  }
  const auto selection = selection_of(where);
  auto drivers = sorted_drivers(master);
  add_not_taken_up(drivers, master.orders());
  for (const auto& one : chosen(std::move(drivers), selection)) ids.push_back(one.instance);
  if (ids.empty())
    throw RequestFailed("no driver instance is chosen by these options; `iotcloud drivers` takes them too");
  return ids;
}

DriverRecord driver_of(const std::string& word, MasterClient& master) {
  auto drivers = sorted_drivers(master);
  const discovery::InstanceId id = completed(word, drivers);
  for (auto& driver : drivers) {
    if (driver.instance == id) return std::move(driver);
  }
  throw RequestFailed(fmt::format(
      "no driver instance \"{}\"; `iotcloud drivers` lists them, `iotcloud history` those that are gone too", word));
}

std::vector<std::string> ids_of_names(const std::vector<std::string>& words, MasterClient& master) {
  if (words.empty()) return {};
  const auto drivers = sorted_drivers(master);
  std::vector<std::string> ids;
  for (const auto& word : words) {
    const auto found = meant(word, drivers);
    if (found.empty() || !is_named(*found.front(), word)) {
      ids.push_back(word);
      continue;
    }
    for (const auto* one : found) ids.push_back(one->instance.str());
  }
  return ids;
}

std::string bytes_of(const std::string& path) {
  if (std::filesystem::is_directory(path)) throw config::Error(fmt::format("{} is a folder, not a file", path));
  std::ifstream in(path, std::ios::binary);
  std::string bytes(std::istreambuf_iterator<char>(in), {});
  if (!in) throw config::Error(fmt::format("{} cannot be read: {}", path, std::strerror(errno)));
  return bytes;
}

}  // namespace iotcloud::master::cli
