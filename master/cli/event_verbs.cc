// events
#include <chrono>
#include <map>
#include <ostream>
#include <set>
#include <tuple>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/driver_verbs.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/topology/topology_verbs.h>
#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

using Json = nlohmann::ordered_json;

namespace {

constexpr std::chrono::seconds pause_between_questions{1};

/// Something that happened: to a driver instance, a gateway or a topology.
struct Event {
  std::int64_t time_ms = 0;
  std::string what, name, state, reason;
};

/// What is compared from one look at the fleet to the next: what, name -> state, reason.
using Present = std::map<std::pair<std::string, std::string>, std::pair<std::string, std::string>>;

Present present(MasterClient& master) {
  Present all;
  for (const auto& gateway : master.gateways()) {
    std::string state = gateway.alive ? "ready" : "lost";
    if (gateway.draining) state += ", draining";
    if (!gateway.frozen.empty()) state += ", frozen";
    all[{"gateway", gateway.record.id.str()}] = {state, gateway.alive ? gateway.record.trouble : ""};
  }
  for (const auto& topology : master.topologies()) {
    std::vector<std::string> troubles;
    for (const auto& worker : topology.workers) {
      if (!worker.trouble.empty()) troubles.push_back(worker.trouble);
    }
    const auto workers = topology.workers.size();
    all[{"topology", topology.record.name.str()}] = {
        fmt::format("{}, {} worker{}", topology_state(topology), workers, workers == 1 ? "" : "s"),
        fmt::format("{}", fmt::join(troubles, "; "))};
  }
  return all;
}

/// What became different between two looks.
std::vector<Event> differences(const Present& before, const Present& now) {
  std::vector<Event> events;
  for (const auto& [key, state] : now) {
    const auto was = before.find(key);
    if (was == before.end() || was->second != state)
      events.push_back({now_ms(), key.first, key.second, state.first, state.second});
  }
  for (const auto& [key, state] : before) {
    if (!now.contains(key)) events.push_back({now_ms(), key.first, key.second, "gone", ""});
  }
  return events;
}

class Events final : public Verb {
 public:
  Events()
      : Verb({"events",
              "Show what happened to driver instances, the latest last; with --follow also what happens to gateways "
              "and topologies",
              "iotcloud events -f", security::Role::viewer}) {}

  void declare(CLI::App& options) override {
    options.add_flag("-f,--follow", follow_, "go on until interrupted");
    options.add_option("-n,--lines", lines_, "at most this many of the latest")
        ->check(CLI::Range(0, 10'000))
        ->default_str("20")
        ->type_name("N");
  }
  bool goes_on() const override { return follow_; }

  int run(Call& call) override {
    const auto master = call.connect();
    Present before = follow_ ? present(*master) : Present();
    int status = show_changes(call, *master, lines_, true);
    while (follow_ && call.out && pause(pause_between_questions)) {
      try {
        Present now = present(*master);
        for (const auto& event : differences(before, now)) print(call, event);
        before = std::move(now);
        status = show_changes(call, *master, most_changes, false);
      } catch (const std::runtime_error& e) {  // the next look may find a master again
        if (trouble_ != e.what()) call.err << "iotcloud: " << e.what() << '\n';
        trouble_ = e.what();
        continue;
      }
      trouble_.clear();
    }
    return status;
  }

 private:
  static constexpr std::int32_t most_changes = 1'000;
  using Seen = std::tuple<std::int64_t, std::string, std::string>;

  /// Shows the changes of state that were not shown. \param first look: a gateway that is silent is named
  int show_changes(Call& call, MasterClient& master, std::int32_t most, bool first) {
    const auto history = master.history({}, {}, first && !follow_ ? most : most_changes);
    std::map<std::string, std::string> names;
    for (const auto& driver : master.drivers()) {
      if (!driver.deployment.empty()) names[driver.instance.str()] = full_name(driver);
    }
    std::set<Seen> told;
    std::size_t skip = 0;
    if (first && history.changes.size() > static_cast<std::size_t>(most))
      skip = history.changes.size() - static_cast<std::size_t>(most);
    for (std::size_t i = 0; i < history.changes.size(); ++i) {
      const auto& change = history.changes[i];
      const Seen key{change.time_ms, change.instance.str(), change.state};
      if (!told.insert(key).second || seen_.contains(key) || i < skip) continue;
      const auto name = names.find(change.instance.str());
      const std::string shown = name == names.end() ? change.instance.str() : name->second;
      print(call, {change.time_ms, "driver", fmt::format("{} ({}) on {}", shown, change.driver, change.gateway),
                   change.state, change.reason});
    }
    if (!history.silent.empty()) told.merge(seen_);  // what a silent gateway said is not shown again
    seen_ = std::move(told);
    call.out.flush();
    if (first) {
      for (const auto& [gateway, why] : history.silent)
        call.err << fmt::format("iotcloud: the history of {} is missing: {}\n", printable(gateway), printable(why));
    }
    return history.silent.empty() ? exit_ok : exit_failed;
  }

  static void print(Call& call, const Event& event) {
    if (call.format == Format::table) {
      call.out << fmt::format("{}  {:<8}  {}  {}{}\n", moment(event.time_ms), event.what, printable(event.name),
                              printable(event.state), event.reason.empty() ? "" : ": " + printable(event.reason));
      return;
    }
    call.out << (call.format == Format::yaml ? "- " : "")
             << discovery::to_text(Json{{"time_ms", event.time_ms},
                                        {"what", event.what},
                                        {"name", event.name},
                                        {"state", event.state},
                                        {"reason", event.reason}})
             << '\n';
  }

  bool follow_ = false;
  std::int32_t lines_ = 20;
  std::set<Seen> seen_;
  std::string trouble_;
};

}  // namespace

void add_event_verbs(Verbs& verbs) {
  verbs.add<Events>();
}

}  // namespace iotcloud::master::cli
