#include <chrono>
#include <filesystem>

#include <nlohmann/json.hpp>

#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/endpoints/endpoints.h>
#include <iotcloud/topology/storm/job/job.h>
#include <iotcloud/topology/storm/job/storm_limits.h>
#include <iotcloud/topology/worker/check.h>

namespace iotcloud::topology::storm {

namespace {

using Json = nlohmann::ordered_json;

constexpr const char* park = "org.apache.storm.policy.WaitStrategyPark";
/// A crash leaves its report among the worker's artifacts, beside its logs; elsewhere Storm would delete it.
constexpr const char* crash_report = "-XX:ErrorFile=artifacts/hs_err_%p.log";

/// The value that a text stands for: JSON, or the text.
Json value_of(const std::string& text) {
  Json value = Json::parse(text, nullptr, false);
  return value.is_discarded() ? Json(text) : value;
}

/// Factories for the check; nothing connects.
EndpointFactories unconnected(const TopologyDefinition& definition, config::Metrics& unused) {
  const auto services = std::make_shared<EndpointServices>();
  services->topology = definition.name;
  services->clock = &config::system_clock();
  services->metrics = &unused;
  return endpoint_factories(services);
}

}  // namespace

std::string storm_conf(const TopologyDefinition& definition) {
  const StormSettings& storm = definition.storm;
  const RunSettings& runtime = definition.runtime;
  Json conf{{"topology.workers", storm.workers},
            {"topology.message.timeout.secs", std::chrono::ceil<std::chrono::seconds>(runtime.message_timeout).count()},
            // Storm's own strategies burn a core and more while nothing happens.
            {"topology.spout.wait.strategy", park},
            {"topology.spout.wait.park.microsec", storm.spout_wait.count()},
            {"topology.bolt.wait.strategy", park},
            {"topology.bolt.wait.park.microsec", storm.bolt_wait.count()},
            {"topology.backpressure.wait.strategy", park},
            {"topology.backpressure.wait.park.microsec", storm.back_pressure_wait.count()},
            // Storm would give all tuples to tasks of the same worker as long as these keep up.
            {"topology.disable.loadaware.messaging", true},
            {"topology.worker.childopts",
             storm.worker_options.empty() ? std::string(crash_report) : crash_report + (" " + storm.worker_options)}};
  if (!runtime.acking) {
    conf["topology.acker.executors"] = 0;
  } else if (storm.ackers) {
    conf["topology.acker.executors"] = *storm.ackers;
  }
  if (runtime.max_spout_pending > 0) conf["topology.max.spout.pending"] = runtime.max_spout_pending;
  if (runtime.mailbox_capacity > 0) conf["topology.executor.receive.buffer.size"] = runtime.mailbox_capacity;
  for (const auto& [key, text] : storm.conf) conf[key] = value_of(text);
  return conf.dump();
}

Job make_job(const std::string& file, const std::vector<std::string>& folders) {
  Job job;
  job.file = file;
  config::YamlSection::read_file(file, [&](config::YamlSection& root) {
    root.is_for_another_machine();
    const auto definition = TopologyDefinition::read(root, file);
    ComponentRegistry components;
    job.libraries = load_libraries(definition, folders, components);
    config::Metrics unused;
    const Topology topology = assemble(definition, components, unconnected(definition, unused));
    if (root.has_errors()) return;
    job.notes = check_limits(definition, topology);
    if (root.has_errors()) return;
    job.name = definition.name.str();
    job.nimbus = definition.storm.nimbus;
    job.registry = definition.registry;
    job.zk_root = definition.zk_root;
    job.conf = storm_conf(definition);
    job.topology = to_storm(definition, topology);
  });
  return job;
}

Job make_library_job(const std::string& library) {
  Job job;
  job.libraries = {std::filesystem::absolute(library)};
  return job;
}

}  // namespace iotcloud::topology::storm
