#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include <unistd.h>

#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/config/daemon/reload.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/process_starter.h>
#include <iotcloud/rpc/http/health_page.h>
#include <iotcloud/rpc/http/http_server.h>
#include <iotcloud/rpc/http/metrics_endpoint.h>
#include <iotcloud/topology/pool/pool_daemon.h>
#include <iotcloud/topology/pool/pooled_worker.h>
#include <iotcloud/topology/worker/check.h>
#include <iotcloud/topology/worker/page_requests.h>
#include <iotcloud/topology/worker/placement.h>
#include <iotcloud/topology/worker/worker.h>

namespace {

namespace config = iotcloud::config;
namespace processes = iotcloud::processes;
namespace rpc = iotcloud::rpc;
namespace topology = iotcloud::topology;

rpc::PageSettings pages_of(const topology::TopologyDefinition& definition) {
  auto pages = definition.pages;
  if (pages.address.empty()) pages.address = "127.0.0.1:0";
  return pages;
}

/// The host:port at which others reach the pages: with the host that the settings name, or, if the pages are served at
/// all addresses, with this machine's name. The certificate must have the same name. \param bound their address with
/// its real port
std::string reached_at(const std::string& address, const std::string& bound) {
  const std::string host = address.substr(0, address.rfind(':'));
  if (config::is_loopback(host)) return bound;
  const bool everywhere = host == "0.0.0.0" || host == "::" || host == "[::]";
  return (everywhere ? config::host_name() : host) + bound.substr(bound.rfind(':'));
}

/// The worker and its pages: /metrics for Prometheus, /healthz, /topology and /tap for `iotcloud topology`,
/// /trace and /units for the console.
class WorkerService final : public config::DaemonService {
 public:
  explicit WorkerService(topology::WorkerOptions options)
      : settings_(pages_of(options.definition)),
        placement_(options.definition.runtime.placement),
        worker_(std::move(options)) {}
  void start(const std::stop_token& stop) override {
    topology::place_threads(placement_);  // before the first of them starts
    pages_.emplace(
        settings_,
        std::map<std::string, rpc::HttpHandler>{
            {"/metrics", rpc::metrics_page(config::process_metrics())},
            {"/healthz", rpc::health_page([this] { return trouble(); })},
            {"/topology", [this](const auto&) { return describe(); }},
            {"/tap",
             [this](const auto& request) {
               return answer([&] { return topology::tap_page(worker_, request.query); });
             }},
            {"/units", [this](const auto&) { return answer([&] { return topology::units_page(worker_); }); }},
            {"/trace", [this](const auto& request) {
               return answer([&] { return topology::trace_page(worker_, request.query); });
             }}});
    worker_.show_http_address(reached_at(settings_.address, pages_->address()), !settings_.tls.empty());
    worker_.start(stop);
    started_ = true;
  }
  void stop(std::chrono::milliseconds limit) override { worker_.stop(limit); }
  void reload() override {
    config::Reload parts;
    parts.part([&] { worker_.reload(); });
    parts.part([&] { pages_->reload(); });
    parts.finish();
  }
  std::string trouble() const override { return started_ ? worker_.trouble() : "starting"; }
  const std::string& name() const { return worker_.name(); }
  topology::LongCall longest_call() const { return worker_.longest_call(); }

 private:
  rpc::HttpAnswer describe() const { return {200, "application/json", worker_.describe()}; }

  template <typename Page>
  rpc::HttpAnswer answer(const Page& page) {
    try {
      return {200, "application/json", page()};
    } catch (const std::invalid_argument& error) {
      return {400, "text/plain", error.what()};
    }
  }

  const rpc::PageSettings settings_;
  const topology::PlacementSettings placement_;
  topology::Worker worker_;
  std::atomic<bool> started_{false};
  std::optional<rpc::HttpServer> pages_;  ///< last, because its pages use the worker
};

/// The plugin folders of the build and of the installation.
std::vector<std::string> library_folders() {
  const auto program = std::filesystem::read_symlink("/proc/self/exe").parent_path();
  return {program.parent_path() / "plugins", program.parent_path() / "lib/iotcloud/plugins"};
}

std::unique_ptr<WorkerService> build_worker(const std::string& file, std::map<std::string, std::string> libraries,
                                            std::function<void()> on_joined) {
  topology::WorkerOptions options{.definition = topology::TopologyDefinition::load(file),
                                  .components = {},
                                  .library_folders = library_folders(),
                                  .libraries = std::move(libraries),
                                  .registry = nullptr,
                                  .clock = nullptr,
                                  .metrics = nullptr,
                                  // run_daemon() waits for this signal: the process ends in order, with status 0.
                                  .on_killed = [] { ::kill(getpid(), SIGTERM); },
                                  .on_joined = std::move(on_joined)};
  return std::make_unique<WorkerService>(std::move(options));
}

std::unique_ptr<config::DaemonService> build(const std::string& file) {
  return build_worker(file, {}, {});
}

/// A worker that a pool has started: it tells the pool how it fares.
class PooledService final : public config::DaemonService {
 public:
  PooledService(const std::string& folder, const std::string& file)
      : link_(folder), worker_(build_worker(file, link_.spec().libraries, [this] { show_running(); })) {}
  void start(const std::stop_token& stop) override {
    link_.show({false, worker_->name()});
    try {
      worker_->start(stop);
    } catch (const std::exception& error) {
      topology::PooledWorker::leave_word(link_.folder(), false, error.what());
      throw;
    }
    link_.probe_with([this](topology::pooled::WorkerReport& answer) {
      static_cast<void>(worker_->trouble());
      const auto call = worker_->longest_call();
      answer.component = call.component;
      answer.task = call.task;
      answer.call_ms = call.age.count();
    });
  }
  void stop(std::chrono::milliseconds limit) override {
    link_.probe_with({});
    worker_->stop(limit);
  }
  void reload() override { worker_->reload(); }
  std::string trouble() const override { return worker_->trouble(); }

 private:
  /// It runs once others find it in the registry: whoever submits the topology looks there next.
  void show_running() { link_.show({true, worker_->name()}); }

  topology::PooledWorker link_;
  const std::unique_ptr<WorkerService> worker_;
};

/// Runs `--check FILE`. \return the exit status.
int check(const char* file) {
  try {
    const std::string description = topology::check_topology(file, library_folders());
    return std::fwrite(description.data(), 1, description.size(), stdout) == description.size() ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "iotcloud-topology: %s\n", error.what());
    return 2;
  }
}

/// Runs `--check-library FILE`: the answer is the last line. \return the exit status.
int check_library(const char* file) {
  const std::string answer = topology::check_library(file);
  std::printf("\n%s\n", answer.c_str());
  return answer.starts_with("{\"error\"") ? 1 : 0;
}

/// Runs `--check-submission FILE`: the answer is the last line. \return the exit status.
int check_submission(const char* file) {
  const std::string answer = topology::check_submission(file, library_folders());
  std::printf("\n%s\n", answer.c_str());
  return answer.starts_with("{\"error\"") ? 1 : 0;
}

/// Runs the daemon without these arguments, which stand before its own.
int run_without(int count, int argc, char** argv, const config::DaemonOptions& options) {
  std::vector<char*> rest{argv[0]};
  rest.insert(rest.end(), argv + 1 + count, argv + argc);
  rest.push_back(nullptr);
  return config::run_daemon(static_cast<int>(rest.size()) - 1, rest.data(), options);
}

int run_pool(int argc, char** argv) {
  return run_without(1, argc, argv,
                     {.name = "iotcloud-topology --pool",
                      .description = "Runs its share of the topologies that are submitted: `iotcloud topology submit`.",
                      .build = topology::make_pool_daemon,
                      .stop_limit = std::chrono::milliseconds(15'000)});
}

int run_pooled(const std::string& folder, int argc, char** argv) {
  const auto build_pooled = [folder](const std::string& file) {
    try {
      return std::make_unique<PooledService>(folder, file);
    } catch (const std::exception& error) {
      topology::PooledWorker::leave_word(folder, true, error.what());
      throw;
    }
  };
  return run_without(2, argc, argv,
                     {.name = "iotcloud-topology",
                      .description = "Runs one worker of a topology, for a pool.",
                      .build = build_pooled});
}

}  // namespace

int main(int argc, char** argv) {
  const std::string_view first = argc > 1 ? argv[1] : "";
  if (argc == 3 && first == "--check") return check(argv[2]);
  if (argc == 3 && first == "--check-library") return check_library(argv[2]);
  if (argc == 3 && first == "--check-submission") return check_submission(argv[2]);
  if (argc == 2 && first == "--for-pool")
    return processes::serve_starter(processes::OwnedDescriptor(STDIN_FILENO), processes::own_program());
  if (first == "--pool") return run_pool(argc, argv);
  if (argc > 2 && first == "--pooled") return run_pooled(argv[2], argc, argv);
  return config::run_daemon(
      argc, argv,
      {.name = "iotcloud-topology",
       .description =
           "Runs one worker of a topology; start it again, on any machine, to scale out. "
           "`iotcloud-topology --check FILE` only checks a topology and prints its "
           "graph, without contacting registry or broker; `--check-library FILE` loads a component library and "
           "says what it registers. `iotcloud-topology --pool --config FILE` runs a pool of workers, to which "
           "topologies are submitted; systemd starts `iotcloud-topology --for-pool` if a pool asks for a worker of "
           "another user (iotcloud-worker.socket).",
       .build = build});
}
