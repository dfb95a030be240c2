// describe, history, logs
#include <ostream>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/driver_verbs.h>
#include <iotcloud/master/cli/log_lines.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/master/listing/secret_properties.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

using discovery::DriverRecord;
using security::Role;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

/// The plugin that the instance runs, and which trusted key signed it, if any.
std::string plugin_words(const DriverRecord& driver) {
  if (driver.plugin.empty()) return "-";
  if (driver.sha256.empty()) return driver.plugin;
  return fmt::format("{} (SHA-256 {}..., {})", driver.plugin, security::short_sha256(driver.sha256),
                     driver.signed_by.empty() ? "not signed by a trusted key" : "signed by " + driver.signed_by);
}

void print_record(const DriverRecord& driver, std::ostream& out) {
  print_table(out, {"instance", driver.instance},
              {{"name", printable(full_name(driver))},
               {"driver", printable(driver.name)},
               {"gateway", printable(driver.gateway)},
               {"state", to_string(driver.state)},
               {"since", moment(driver.since_ms)},
               {"reason", driver.reason.empty() ? "-" : printable(driver.reason)},
               {"plugin", printable(plugin_words(driver))},
               {"metadata", printable(metadata_words(driver))}});
  if (driver.channels.empty()) return;
  out << '\n';
  Rows rows;
  for (const auto& channel : driver.channels) {
    rows.push_back({printable(channel.name), channel.direction == discovery::Direction::out ? "out" : "in",
                    channel.shared ? "shared" : "exclusive", printable(channel.transport),
                    printable(without_password(channel.broker_url))});
  }
  print_table(out, {"CHANNEL", "DIRECTION", "KIND", "BROKER", "URL"}, rows);
}

/// A verb about one instance.
class OfOne : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override {
    options.add_option("ID", ids_, "the id of an instance, its beginning, or its name (meter/2)")
        ->required()
        ->expected(1);
  }

 protected:
  /// \throws RequestFailed when there is none.
  DriverRecord find(MasterClient& master) const { return driver_of(ids_.front(), master); }

 private:
  std::vector<std::string> ids_;  ///< one id
};

class Describe final : public OfOne {
 public:
  Describe()
      : OfOne({"describe", "Show all that is known of a driver instance: its record, channels and history",
               "iotcloud describe 3f2a9c", Role::viewer}) {}

  int run(Call& call) override {
    constexpr std::int32_t changes = 100;
    const auto master = call.connect();
    const auto driver = find(*master);
    const auto history = master->history({driver.instance.str()}, {driver.gateway}, changes);
    if (call.format != Format::table) {
      Json json = driver_json(driver);
      json["history"] = discovery::json_of<Json>(history.changes);
      print_data(call.out, call.format, json);
      return name_silent(history.silent, "the history", call.err);
    }
    print_record(driver, call.out);
    if (!history.changes.empty()) {
      call.out << '\n';
      Rows rows;
      for (const auto& change : history.changes)
        rows.push_back({moment(change.time_ms), change.state, printable(change.reason)});
      print_table(call.out, {"TIME", "STATE", "REASON"}, rows);
    }
    return name_silent(history.silent, "the history", call.err);
  }
};

void add_lines(CLI::App& options, std::int32_t& lines, int least, const char* what) {
  options.add_option("-n,--lines", lines, what)->check(CLI::Range(least, 10'000))->default_str("100")->type_name("N");
}

class History final : public Verb {
 public:
  History()
      : Verb({"history", "List the latest changes of state, of instances that are gone too, with time and reason",
              "iotcloud history --gateway lab1", Role::viewer}) {}

  void declare(CLI::App& options) override {
    options.add_option("ID", instances_, "only of these instances: ids, beginnings of ids, or names (meter/2)");
    add_gateways(options, gateways_, "only on these gateways");
    add_lines(options, lines_, 1, "at most this many of the latest");
  }

  int run(Call& call) override {
    const auto master = call.connect();
    const auto history = master->history(ids_of_names(instances_, *master), gateways_, lines_);
    if (history.changes.empty() && history.silent.empty() && !instances_.empty()) {
      throw RequestFailed(
          fmt::format("no gateway remembers a change of state of \"{}\"; they remember the latest since they "
                      "started, `iotcloud history` lists them",
                      fmt::join(instances_, "\", \"")));
    }
    Rows rows;
    for (const auto& change : history.changes) {
      rows.push_back({moment(change.time_ms), change.instance, printable(change.driver), printable(change.gateway),
                      change.state, printable(change.reason)});
    }
    print(call.out, call.format, {"TIME", "INSTANCE", "DRIVER", "GATEWAY", "STATE", "REASON"}, rows,
          discovery::json_of<Json>(history.changes));
    return name_silent(history.silent, "the history", call.err);
  }

 private:
  std::vector<std::string> instances_;  ///< ids, or how they begin
  std::vector<discovery::GatewayId> gateways_;
  std::int32_t lines_ = 100;
};

class Logs final : public OfOne {
 public:
  Logs() : OfOne({"logs", "Show what a driver instance logs", "iotcloud logs 3f2a9c --follow", Role::viewer}) {}

  void declare(CLI::App& options) override {
    OfOne::declare(options);
    options.add_flag("-f,--follow", follow_, "go on until interrupted");
    options.add_flag("--whole-host", whole_host_, "every line of its driver host, not only those that name it");
    add_lines(options, lines_, 0,
              "of what there is already, at most, looked for in the last 128 KiB of its host's log");
  }
  bool goes_on() const override { return follow_; }

  int run(Call& call) override {
    const auto master = call.connect();
    const auto driver = find(*master);
    const LogChoice choice{whole_host_ ? "" : driver.instance.str(), lines_, follow_};
    return show_log(call, choice, [&](const std::string& position) {
      return master->read_log(driver.gateway, driver.instance, position, most_log_bytes);
    });
  }

 private:
  bool follow_ = false;
  bool whole_host_ = false;
  std::int32_t lines_ = 100;
};

}  // namespace

void add_history_verbs(Verbs& verbs) {
  verbs.add<Describe>();
  verbs.add<History>();
  verbs.add<Logs>();
}

}  // namespace iotcloud::master::cli
