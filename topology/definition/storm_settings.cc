#include <iotcloud/topology/definition/storm_settings.h>

namespace iotcloud::topology {

namespace {

constexpr int most_workers = 10'000;
constexpr const char* prefix = "topology.";

/// Keys of Storm that the topology's file says elsewhere.
const std::map<std::string, std::string>& said_elsewhere() {
  static const std::map<std::string, std::string> keys{
      {"topology.name", "topology.name"},
      {"topology.workers", "engine.storm.workers"},
      {"topology.acker.executors", "engine.storm.ackers"},
      {"topology.message.timeout.secs", "runtime.message_timeout"},
      {"topology.max.spout.pending", "runtime.max_spout_pending"},
      {"topology.executor.receive.buffer.size", "runtime.mailbox_capacity"},
      {"topology.worker.childopts", "engine.storm.worker_options"},
      {"topology.tasks", "tasks of the component"},
      {"topology.tick.tuple.freq.secs", "tick of the bolt"}};
  return keys;
}

void check_conf(const config::YamlSection& storm, const std::map<std::string, std::string>& conf) {
  const config::YamlSection section = config::YamlSection(storm).require_section("conf");
  for (const auto& [key, value] : conf) {
    if (const auto known = said_elsewhere().find(key); known != said_elsewhere().end()) {
      section.refuse(key, "the topology's file has a key of its own for it", "write \"" + known->second + "\"");
    } else if (!key.starts_with(prefix)) {
      section.refuse(key, "a topology sets keys of its own only", "they begin with \"topology.\"");
    }
  }
}

}  // namespace

StormSettings read_storm_settings(config::YamlSection& root) {
  StormSettings settings;
  auto engine = root.optional_section("engine");
  if (!engine) return settings;
  if (auto storm = engine->optional_section("storm")) {
    settings.nimbus = storm->strings_or("nimbus", {});
    settings.workers = static_cast<int>(storm->int_or("workers", settings.workers, 1, most_workers));
    if (storm->has("ackers")) settings.ackers = static_cast<int>(storm->int_or("ackers", 1, 1, most_workers));
    settings.spout_wait = storm->duration_or("spout_wait", settings.spout_wait);
    settings.bolt_wait = storm->duration_or("bolt_wait", settings.bolt_wait);
    settings.back_pressure_wait = storm->duration_or("back_pressure_wait", settings.back_pressure_wait);
    settings.worker_options = storm->string_or("worker_options", "");
    settings.shared_folders = storm->strings_or("shared_folders", {});
    settings.conf = storm->string_map("conf");
    if (!settings.conf.empty()) check_conf(*storm, settings.conf);
    storm->finish();
  }
  engine->finish();
  return settings;
}

}  // namespace iotcloud::topology
