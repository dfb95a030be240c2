#include <filesystem>
#include <memory>
#include <optional>

#include <iotcloud/config/daemon.h>
#include <iotcloud/config/exposition/metrics_endpoint.h>
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

std::unique_ptr<config::Service> build(const std::string& file) {
  topology::WorkerOptions options{.definition = topology::TopologyDefinition::load(file),
                                  .components = {},
                                  .library_folders = {},
                                  .registry = nullptr,
                                  .clock = nullptr,
                                  .metrics = nullptr};
  // Where the build and the installation put component libraries.
  const auto program = std::filesystem::read_symlink("/proc/self/exe").parent_path();
  options.library_folders = {program.parent_path() / "plugins", program.parent_path() / "lib/iotcloud/plugins"};
  return std::make_unique<WorkerService>(std::move(options));
}

}  // namespace

int main(int argc, char** argv) {
  return config::run_daemon(argc, argv,
                            {.name = "iotcloud-topology",
                             .description = "Runs one worker of a topology; run it again, anywhere, to scale out.",
                             .build = build});
}
