#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string_view>

#include <iotcloud/config/daemon.h>
#include <iotcloud/config/exposition/metrics_endpoint.h>
#include <iotcloud/topology/endpoints/check.h>
#include <iotcloud/topology/endpoints/worker.h>

namespace {

namespace config = iotcloud::config;
namespace topology = iotcloud::topology;

/// The worker, and its metrics page where the YAML asks for one.
class WorkerService final : public config::Service {
 public:
  explicit WorkerService(topology::WorkerOptions options)
      : metrics_address_(options.definition.metrics_address), worker_(std::move(options)) {}
  void start() override {
    if (!metrics_address_.empty()) metrics_.emplace(metrics_address_, config::process_metrics());
    worker_.start();
  }
  void stop(std::chrono::milliseconds limit) override { worker_.stop(limit); }

 private:
  const std::string metrics_address_;
  std::optional<config::MetricsEndpoint> metrics_;
  topology::Worker worker_;
};

/// Where the build and the installation put component libraries.
std::vector<std::string> library_folders() {
  const auto program = std::filesystem::read_symlink("/proc/self/exe").parent_path();
  return {program.parent_path() / "plugins", program.parent_path() / "lib/iotcloud/plugins"};
}

std::unique_ptr<config::Service> build(const std::string& file) {
  topology::WorkerOptions options{.definition = topology::TopologyDefinition::load(file),
                                  .components = {},
                                  .library_folders = library_folders(),
                                  .registry = nullptr,
                                  .clock = nullptr,
                                  .metrics = nullptr};
  return std::make_unique<WorkerService>(std::move(options));
}

/// `--check FILE`. \return the exit status.
int check(const char* file) {
  try {
    const std::string description = topology::check_topology(file, library_folders());
    return std::fwrite(description.data(), 1, description.size(), stdout) == description.size() ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "iotcloud-topology: %s\n", error.what());
    return 2;
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 3 && std::string_view(argv[1]) == "--check") return check(argv[2]);
  return config::run_daemon(argc, argv,
                            {.name = "iotcloud-topology",
                             .description = "Runs one worker of a topology; run it again, anywhere, to scale out. "
                                            "`iotcloud-topology --check FILE` only checks a topology and prints its "
                                            "graph, and contacts nobody.",
                             .build = build});
}
