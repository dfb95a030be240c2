#include <algorithm>
#include <chrono>
#include <ctime>
#include <deque>
#include <ostream>
#include <sstream>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/master/cli/drivers_command.h>
#include <iotcloud/master/cli/history_command.h>
#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/topology/topology_pages.h>

namespace iotcloud::master::cli {

using discovery::wire::TDirection;
using discovery::wire::TSensor;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

constexpr std::int32_t most_at_once = 128 * 1024;
constexpr std::chrono::milliseconds follow_pause{500};

/// Wall time as people read it, UTC.
std::string moment(std::int64_t time_ms) {
  if (time_ms <= 0) return "-";
  constexpr std::int64_t ms = 1000;
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(static_cast<std::time_t>(time_ms / ms)), time_ms % ms);
}

Json to_json(const wire::TDriverHistory& history) {
  Json changes = Json::array();
  for (const auto& change : history.changes) {
    changes.push_back({{"time_ms", change.timeMs},
                       {"gateway", change.gateway},
                       {"instance", change.instance},
                       {"driver", change.driver},
                       {"state", change.state},
                       {"reason", change.reason}});
  }
  return changes;
}

/// \return the exit status.
int name_silent(const wire::TDriverHistory& history, std::ostream& err) {
  for (const auto& [gateway, why] : history.silent) {
    err << fmt::format("iotcloud: the history of {} is missing: {}\n", printable(gateway), printable(why));
  }
  return history.silent.empty() ? exit_ok : exit_failed;
}

/// \throws Failed when there is none.
TSensor find_driver(const std::string& beginning, MasterClient& master) {
  const std::string id = full_ids({beginning}, master).front();
  for (auto& driver : master.drivers()) {
    if (driver.sensorId == id) return std::move(driver);
  }
  throw Failed(
      fmt::format("no driver instance \"{}\"; `iotcloud drivers` lists them, `iotcloud history` those that are "
                  "gone too",
                  beginning));
}

void print_record(const TSensor& driver, std::ostream& out) {
  print_table(out, {"instance", driver.sensorId},
              {{"name", printable(full_name(driver))},
               {"driver", printable(driver.name)},
               {"gateway", printable(driver.siteId)},
               {"state", driver.exactState},
               {"since", moment(driver.sinceMs)},
               {"reason", driver.reason.empty() ? "-" : printable(driver.reason)},
               {"plugin", printable(plugin_words(driver))},
               {"metadata", printable(metadata_words(driver))}});
  if (driver.channels.empty()) return;
  out << '\n';
  Rows rows;
  for (const auto& channel : driver.channels) {
    rows.push_back({printable(channel.name), channel.direction == TDirection::OUT ? "out" : "in",
                    channel.grouped ? "shared" : "exclusive", printable(channel.transport),
                    printable(without_password(channel.brokerUrl))});
  }
  print_table(out, {"CHANNEL", "DIRECTION", "KIND", "BROKER", "URL"}, rows);
}

/// The last `most` lines of the text that are of interest.
std::deque<std::string> last_lines(const std::string& text, const std::string& word, std::size_t most) {
  std::deque<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) {
    if (!word.empty() && line.find(word) == std::string::npos) continue;
    lines.push_back(std::move(line));
    if (lines.size() > most) lines.pop_front();
  }
  return lines;
}

/// Lines as a stream: JSON has a text on each line, YAML an item of a list.
void print_lines(const std::deque<std::string>& lines, Format format, std::ostream& out) {
  for (const auto& line : lines) {
    if (format == Format::table) {
      out << printable(line) << '\n';
    } else {
      out << (format == Format::yaml ? "- " : "") << Json(line).dump(-1, ' ', false, Json::error_handler_t::replace)
          << '\n';
    }
  }
  out << std::flush;
}

}  // namespace

int describe(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err) {
  const auto driver = find_driver(command.instances.front(), master);
  const auto history = master.history({driver.sensorId}, {driver.siteId}, command.lines);
  if (command.format != Format::table) {
    Json json = to_json(driver);
    json["history"] = to_json(history);
    print_data(out, command.format, json);
    return name_silent(history, err);
  }
  print_record(driver, out);
  if (!history.changes.empty()) {
    out << '\n';
    Rows rows;
    for (const auto& change : history.changes)
      rows.push_back({moment(change.timeMs), change.state, printable(change.reason)});
    print_table(out, {"TIME", "STATE", "REASON"}, rows);
  }
  return name_silent(history, err);
}

int show_history(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err) {
  const auto history = master.history(command.instances, command.gateways, command.lines);
  if (history.changes.empty() && history.silent.empty() && !command.instances.empty()) {
    throw Failed(
        fmt::format("no gateway remembers a change of state of \"{}\"; they remember the latest since they "
                    "started, `iotcloud history` lists them",
                    fmt::join(command.instances, "\", \"")));
  }
  if (command.format == Format::table) {
    Rows rows;
    for (const auto& change : history.changes) {
      rows.push_back({moment(change.timeMs), change.instance, printable(change.driver), printable(change.gateway),
                      change.state, printable(change.reason)});
    }
    print_table(out, {"TIME", "INSTANCE", "DRIVER", "GATEWAY", "STATE", "REASON"}, rows);
  } else {
    print_data(out, command.format, to_json(history));
  }
  return name_silent(history, err);
}

int show_logs(const Command& command, MasterClient& master, std::ostream& out) {
  const auto driver = find_driver(command.instances.front(), master);
  const std::string word = command.whole_host ? "" : driver.sensorId;
  auto part = master.read_log(driver.siteId, driver.sensorId, "", most_at_once);
  // What is left of an earlier part comes at once.
  const auto rest = [&] { return part.text.size() < most_at_once / 2 ? follow_pause : std::chrono::milliseconds{0}; };
  const auto lines = last_lines(part.text, word, static_cast<std::size_t>(command.lines));
  if (!command.follow && command.format == Format::json) {
    print_data(out, command.format, lines);
    return exit_ok;
  }
  print_lines(lines, command.format, out);
  while (command.follow && pause(rest())) {
    part = master.read_log(driver.siteId, driver.sensorId, part.position, most_at_once);
    print_lines(last_lines(part.text, word, most_at_once), command.format, out);
  }
  return exit_ok;
}

}  // namespace iotcloud::master::cli
