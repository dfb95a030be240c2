#include <cerrno>
#include <cstring>
#include <filesystem>
#include <optional>

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/processes/random_name.h>
#include <iotcloud/processes/unix_socket.h>
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/process_link.h>
#include <iotcloud/topology/pool/worker_processes.h>

namespace iotcloud::topology {

namespace fs = std::filesystem;

namespace {

void make_folder(const std::string& path) {
  if (mkdir(path.c_str(), S_IRWXU) != 0 && errno != EEXIST)
    throw config::Error(fmt::format("the folder {} cannot be made: {}", path, std::strerror(errno)));
}

void write_file(const std::string& path, const std::string& text) {
  processes::write_all(processes::create_file(path), text, path);
}

std::string log_folder(const std::string& state_folder, const discovery::TopologyName& topology) {
  return fmt::format("{}/logs/{}", state_folder, topology);
}

}  // namespace

WorkerProcesses::WorkerProcesses(Options options)
    : options_([&options] {
        if (options.program.empty()) options.program = processes::own_program();
        return std::move(options);
      }()),
      starter_({options_.confinement.user, options_.starter, "iotcloud-worker", "worker_user"}, options_.state_dir) {
  for (const char* name : {"workers", "logs"}) {
    const std::string folder = options_.state_dir + "/" + name;
    make_folder(folder);
    if (const auto* account = starter_.account()) account->let_pass(folder);
  }
  if (!options_.require_version) return;
  security::PluginVersions::Options versions;
  versions.file = options_.state_dir + "/library-versions";
  versions.allow_rollback = options_.allow_rollback;
  versions.require_version = true;
  versions.keys = "libraries";
  versions_.emplace(std::move(versions));
}

std::string WorkerProcesses::log_of(const std::string& state_folder, const discovery::PlaceId& place) {
  return fmt::format("{}/{}.log", log_folder(state_folder, place.topology), place.number);
}

/// The path of a library in the store, whose bytes are those of the order and, if that is required, signed, with a
/// version that may run.
std::string WorkerProcesses::checked_library(const discovery::SentLibrary& library, bool goes_back) {
  const auto path = options_.store->path_of(library.sha256);
  if (!path)
    throw config::Error(fmt::format("the component library {} (SHA-256 {}) is not in this pool", library.file,
                                    security::short_sha256(library.sha256)));
  const std::string content = processes::read_file(*path, 0);
  if (security::sha256_hex(content) != library.sha256)
    throw WorkerRefused(fmt::format("{} has other bytes than those that were sent as {}", *path, library.file));
  const std::string signature_path = options_.store->signature_path_of(library.sha256);
  const std::string signature = fs::exists(signature_path) ? processes::read_file(signature_path, 0) : "";
  std::string signer;
  try {
    signer = options_.trust->admit(library.file, content, signature);
  } catch (const config::Error& error) {
    throw WorkerRefused(error.what());
  }
  if (!versions_ || signer.empty() || goes_back) return *path;
  try {
    versions_->admit(library.file, security::parse_plugin_signature(signature), false);
  } catch (const security::VersionRefused& refused) {
    throw WorkerRefused(refused.what());
  }
  return *path;
}

/// What a worker in this folder gives up: with restricted files it reaches the system's, its program's and libraries'
/// folders, its own folder and its topology's logs, besides those that are configured.
pooled::WorkerConfinement WorkerProcesses::confinement_in(const std::string& folder,
                                                          const discovery::TopologyName& topology) const {
  processes::Confinement confinement = options_.confinement;
  confinement.ports = processes::ports_of(options_.ports, topology);
  if (confinement.files) {
    auto& [read, write] = *confinement.files;
    const auto& by_all = processes::readable_by_all();
    read.insert(read.end(), by_all.begin(), by_all.end());
    read.insert(read.end(), {fs::path(options_.program).parent_path().string(), options_.state_dir + "/libraries"});
    write.insert(write.end(), {"/dev", folder, log_folder(options_.state_dir, topology)});
  }
  return pooled::worker_confinement(confinement);
}

processes::LogFile::Options WorkerProcesses::log_file(const discovery::PlaceId& place) const {
  return {log_of(options_.state_dir, place), static_cast<std::uint64_t>(options_.log_limit_mb) << 20,
          options_.logs_kept};
}

/// Makes what a worker finds in its folder, and its log. A worker of another account can read the order to it, write to
/// its log and to the file for its word, and change nothing else.
void WorkerProcesses::prepare(const std::string& folder, const WorkerOrder& order,
                              const pooled::WorkerSpec& spec) const {
  const std::string logs = log_folder(options_.state_dir, spec.topology), yaml = folder + "/" + pooled::yaml_name;
  make_folder(folder);
  make_folder(logs);
  write_file(yaml, order.version.yaml);
  write_file(pooled::spec_path(folder), pooled::encode(spec));
  const auto* account = starter_.account();
  if (account == nullptr) return;
  for (const auto& passed : {folder, logs}) account->let_pass(passed);
  for (const auto& read : {yaml, pooled::spec_path(folder)}) account->let_read(read);
  for (const auto& written : {folder + "/" + pooled::end_name, spec.log}) account->make_file(written);
}

/// Starts the worker that is to run in this folder.
processes::ChildProcess WorkerProcesses::launch(const std::string& folder, const pooled::WorkerSpec& spec) const {
  // clang-format off
  std::vector<std::string> arguments = {
      options_.program, "--pooled", folder,
      "--config", folder + "/" + pooled::yaml_name,
      "--stop-limit", fmt::format("{:.3f}", static_cast<double>(options_.stop_limit.count()) / 1000)};
  // clang-format on
  const auto as_this_process = config::log_options();
  arguments.insert(arguments.end(), as_this_process.begin(), as_this_process.end());
  auto process = starter_.start(std::move(arguments), processes::environment_of(options_.environment), folder,
                                pooled::socket_name, spec.log);
  try {
    starter_.check(process);
  } catch (const config::Error& error) {
    throw WorkerRefused(error.what());
  }
  return process;
}

std::unique_ptr<WorkerLink> WorkerProcesses::start(const WorkerOrder& order, WorkerEvents events) {
  pooled::WorkerSpec spec;
  spec.pool = options_.pool;
  spec.topology = order.place.topology;
  spec.place = order.place.number;
  spec.version = order.version.number;
  for (const auto& library : order.version.libraries)
    spec.libraries[library.name] = checked_library(library, order.goes_back);
  spec.log = log_of(options_.state_dir, order.place);
  spec.log_limit_mb = options_.log_limit_mb;
  spec.logs_kept = options_.logs_kept;
  if (starter_.passes_socket()) spec.listen_on = processes::ChildStarter::passed_socket;
  const std::string folder = folder_of(processes::random_name());
  spec.confinement = confinement_in(folder, spec.topology);
  try {
    prepare(folder, order, spec);
    auto process = launch(folder, spec);
    pool_logger.info("started worker {} of topology {} as process {}; it logs to {}", spec.place, spec.topology,
                     process.id(), spec.log);
    return link(folder, order.place, std::move(process), std::move(events));
  } catch (const std::exception&) {
    pooled::remove_worker(folder);
    throw;
  }
}

/// The worker in a folder that an earlier run left, if it lives; removes the folder of one that does not.
std::optional<RunningWorker> WorkerProcesses::examine(const std::string& name) const {
  const std::string folder = folder_of(name);
  try {
    const auto spec = pooled::read_spec(folder);
    const auto connection = processes::connect_in(folder, pooled::socket_name);
    const int process = connection ? processes::peer_process(connection) : 0;
    // Opened before the process is looked at: if the worker ends meanwhile, its id may be another process's.
    const auto worker = starter_.found(process);
    if (process > 0 && processes::has_argument(process, folder).value_or(true)) {
      const std::string objection = starter_.objection(process);
      if (objection.empty()) return RunningWorker{name, spec.place_id(), spec.version};
      pool_logger.warn("worker {} of topology {} (process {}) that an earlier run of the pool started is killed: {}",
                       spec.place, spec.topology, process, objection);
      worker.kill();
    }
  } catch (const config::Error& error) {
    pool_logger.warn("{}: {}", folder, error.what());
  }
  pooled::remove_worker(folder);
  return std::nullopt;
}

std::vector<RunningWorker> WorkerProcesses::running() {
  std::vector<std::string> names;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(options_.state_dir + "/workers", error)) {
    if (entry.is_directory(error)) names.push_back(entry.path().filename());
  }
  std::vector<RunningWorker> found;
  for (const auto& name : names) {
    if (auto worker = examine(name)) found.push_back(std::move(*worker));
  }
  return found;
}

std::unique_ptr<WorkerLink> WorkerProcesses::adopt(const RunningWorker& worker, WorkerEvents events) {
  const std::string folder = folder_of(worker.name);
  const int process = processes::peer_process(processes::connect_in(folder, pooled::socket_name));
  return link(folder, worker.place, starter_.found(process), std::move(events));
}

std::unique_ptr<WorkerLink> WorkerProcesses::link(const std::string& folder, const discovery::PlaceId& place,
                                                  processes::ChildProcess process, WorkerEvents events) const {
  ProcessLink::Options options{folder, options_.ping_period, options_.hang_limit, options_.call_limit,
                               starter_.log_keeper(log_file(place))};
  return std::make_unique<ProcessLink>(std::move(options), options_.limits, std::move(process), std::move(events));
}

}  // namespace iotcloud::topology
