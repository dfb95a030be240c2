#include <filesystem>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/worker_protocol.h>

namespace iotcloud::topology::pooled {

namespace {

constexpr std::size_t most_bytes = std::size_t{1} << 20;

template <typename Struct>
std::string text_of(const Struct& value) {
  return discovery::to_text(discovery::to_json<nlohmann::json>(value));
}

template <typename Struct>
Struct read(const std::string& path) {
  return discovery::from_text<Struct>(processes::read_file(path, most_bytes), path);
}

}  // namespace

processes::Confinement confinement_of(const WorkerConfinement& worker) {
  processes::Confinement confinement;
  confinement.user = worker.user;
  confinement.open_files = worker.open_files;
  confinement.processes = worker.processes;
  confinement.no_new_privileges = worker.no_new_privileges;
  confinement.debuggable = worker.debuggable;
  confinement.filter_calls = worker.filter_calls;
  if (worker.readable) confinement.files = processes::FileAccess{*worker.readable, worker.writable};
  confinement.ports = worker.ports;
  return confinement;
}

WorkerConfinement worker_confinement(const processes::Confinement& confinement) {
  WorkerConfinement worker;
  worker.user = confinement.user;
  worker.open_files = confinement.open_files;
  worker.processes = confinement.processes;
  worker.no_new_privileges = confinement.no_new_privileges;
  worker.debuggable = confinement.debuggable;
  worker.filter_calls = confinement.filter_calls;
  if (confinement.files) {
    worker.readable = confinement.files->read;
    worker.writable = confinement.files->write;
  }
  worker.ports = confinement.ports;
  return worker;
}

std::string encode(const WorkerSpec& spec) {
  return text_of(spec);
}
std::string encode(const WorkerEnd& end) {
  return text_of(end);
}
std::string encode(const WorkerReport& report) {
  return processes::frame(text_of(report));
}
std::string encode(const PoolCommand& command) {
  return processes::frame(text_of(command));
}

std::string spec_path(const std::string& folder) {
  return folder + ".json";
}

WorkerSpec read_spec(const std::string& folder) {
  return read<WorkerSpec>(spec_path(folder));
}

void remove_worker(const std::string& folder) {
  std::error_code error;
  for (const auto& path : {folder, spec_path(folder)}) {
    std::filesystem::remove_all(path, error);
    if (error) pool_logger.warn("{} cannot be removed: {}", path, error.message());
  }
}

std::optional<WorkerEnd> read_end(const std::string& folder) try {
  return read<WorkerEnd>(folder + "/" + end_name);
} catch (const config::Error&) {
  return std::nullopt;
}

WorkerReport decode_report(const std::string& body) {
  return discovery::from_text<WorkerReport>(body, "a worker's report");
}
PoolCommand decode_command(const std::string& body) {
  return discovery::from_text<PoolCommand>(body, "a pool's command");
}

}  // namespace iotcloud::topology::pooled
