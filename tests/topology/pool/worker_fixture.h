#pragma once

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <signal.h>
#include <stdlib.h>

#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/topology/pool/views.h>
#include <iotcloud/topology/pool/worker_processes.h>

namespace iotcloud::topology {

/// What a worker has told.
class Told {
 public:
  WorkerEvents events() {
    return {[this](const pooled::WorkerReport& report) {
              const std::lock_guard lock(mutex_);
              report_ = report;
              ++reports_;
              if (report.call_ms > 0) ++answers_;
            },
            [this](const WorkerEnding& ending) {
              const std::lock_guard lock(mutex_);
              ending_ = ending;
            }};
  }
  pooled::WorkerReport report() const {
    const std::lock_guard lock(mutex_);
    return report_;
  }
  /// How many times it told something.
  int reports() const {
    const std::lock_guard lock(mutex_);
    return reports_;
  }
  /// How many times it told of a call.
  int answers() const {
    const std::lock_guard lock(mutex_);
    return answers_;
  }
  bool runs() const {
    return tests::eventually([this] { return report().runs; });
  }
  bool has_ended() const {
    const std::lock_guard lock(mutex_);
    return ending_.has_value();
  }
  WorkerEnding ending() const {
    EXPECT_TRUE(tests::eventually([this] { return has_ended(); }));
    const std::lock_guard lock(mutex_);
    return ending_.value_or(WorkerEnding{});
  }
  /// The process that reported.
  int process() const { return std::stoi(report().worker.substr(report().worker.rfind('-') + 1)); }

 private:
  mutable std::mutex mutex_;
  pooled::WorkerReport report_;
  int reports_ = 0, answers_ = 0;
  std::optional<WorkerEnding> ending_;
};

/// Workers that are real processes; what each does is said by its order.
class WorkerProcessesTest : public testing::Test {
 protected:
  WorkerProcessesTest() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-pool-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    state_ = folder_ + "/" + std::string(120, 's');  // longer than the path of a Unix socket may be
    std::filesystem::create_directories(state_);
    processes::PluginStore::Options store;
    store.folder = folder_ + "/libraries";
    store_ = std::make_shared<processes::PluginStore>(store);
  }
  ~WorkerProcessesTest() override {
    if (told_.report().runs && !told_.has_ended()) kill(told_.process(), SIGKILL);
    std::filesystem::remove_all(folder_);
  }

  std::unique_ptr<WorkerProcesses> make() const {
    WorkerProcesses::Options options;
    options.pool = discovery::PoolId("p1");
    options.state_dir = state_;
    options.store = store_;
    options.trust = trust_;
    options.program = program_;
    options.ping_period = std::chrono::milliseconds{20};
    options.hang_limit = hang_limit_;
    options.call_limit = call_limit_;
    options.confinement = confinement_;
    options.starter = starter_;
    options.log_limit_mb = 1;
    options.limits = limits_;
    options.require_version = require_version_;
    return std::make_unique<WorkerProcesses>(options);
  }
  static WorkerOrder order(const std::string& wanted) {
    WorkerOrder order{{discovery::TopologyName("t"), 3}, views::submission("t", 4).version};
    order.version.yaml = wanted;
    return order;
  }
  /// The names of what is kept of workers.
  std::vector<std::string> kept() const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(state_ + "/workers"))
      names.push_back(entry.path().filename());
    std::sort(names.begin(), names.end());
    return names;
  }

  std::chrono::milliseconds hang_limit_ = tests::patience, call_limit_{0};
  processes::VitalLimits limits_{.memory_bytes = 0, .spin = std::chrono::milliseconds{0}};
  processes::Confinement confinement_;
  std::string starter_, program_ = POOLED_PROGRAM;
  bool require_version_ = false;
  std::string folder_, state_;
  std::shared_ptr<processes::PluginStore> store_;
  std::shared_ptr<const security::TrustedKeys> trust_ = std::make_shared<const security::TrustedKeys>();
  Told told_;
};

}  // namespace iotcloud::topology
