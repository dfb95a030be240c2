#pragma once

#include <algorithm>
#include <chrono>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/pool/worker_launcher.h>

namespace iotcloud::topology {

/// Starts workers that do what the test says. Thread safe.
class FakeLauncher final : public WorkerLauncher {
 public:
  /// A worker that was started, as long as its link lives.
  struct Worker {
    discovery::PlaceId place;
    std::int64_t version = 0;
    WorkerEvents events;
    bool told_to_stop = false;
    std::chrono::milliseconds stop_limit{0};  ///< the latest
    bool goes_back = false;
    void run() const { events.on_report({true, "w"}); }
    void end(WorkerEnding::How how, const std::string& reason = "") const { events.on_ended({how, reason}); }
  };

  std::unique_ptr<WorkerLink> start(const WorkerOrder& order, WorkerEvents events) override {
    const std::lock_guard lock(mutex_);
    if (!refusal_.empty()) throw WorkerRefused(refusal_);
    if (!shortage_.empty()) throw config::Error(shortage_);
    auto worker = add({order.place, order.version.number, std::move(events)});
    worker->goes_back = order.goes_back;
    if (runs_at_once_) worker->run();
    return std::make_unique<Link>(*this, worker);
  }
  std::vector<RunningWorker> running() override { return left_running; }
  std::unique_ptr<WorkerLink> adopt(const RunningWorker& left, WorkerEvents events) override {
    const std::lock_guard lock(mutex_);
    auto worker = add({left.place, left.version, std::move(events)});
    if (runs_at_once_) worker->run();
    return std::make_unique<Link>(*this, worker);
  }

  /// Workers report at once that they run, and end at once when they are told to stop.
  void obey() {
    const std::lock_guard lock(mutex_);
    runs_at_once_ = true;
  }
  /// From now on no worker can be started, for this reason.
  void refuse(std::string why) {
    const std::lock_guard lock(mutex_);
    refusal_ = std::move(why);
  }
  /// For this reason no worker can be started for now; empty: they can be again.
  void run_short(std::string of_what) {
    const std::lock_guard lock(mutex_);
    shortage_ = std::move(of_what);
  }
  /// The workers whose links live.
  std::vector<std::shared_ptr<Worker>> workers() const {
    const std::lock_guard lock(mutex_);
    return workers_;
  }
  /// "TOPOLOGY/PLACE vVERSION" of each of them, sorted; one that was started to go back has " again" behind it.
  std::vector<std::string> running_versions() const {
    std::vector<std::string> names;
    for (const auto& worker : workers()) {
      names.push_back(worker->place.topology.str() + "/" + std::to_string(worker->place.number) + " v" +
                      std::to_string(worker->version) + (worker->goes_back ? " again" : ""));
    }
    std::sort(names.begin(), names.end());
    return names;
  }
  int started() const {
    const std::lock_guard lock(mutex_);
    return started_;
  }

  std::vector<RunningWorker> left_running;  ///< by an earlier run

 private:
  class Link final : public WorkerLink {
   public:
    Link(FakeLauncher& of, std::shared_ptr<Worker> worker) : of_(of), worker_(std::move(worker)) {}
    ~Link() override {
      const std::lock_guard lock(of_.mutex_);
      std::erase(of_.workers_, worker_);
    }
    void stop(std::chrono::milliseconds limit) override {
      const std::lock_guard lock(of_.mutex_);
      worker_->stop_limit = limit;
      worker_->told_to_stop = true;
      if (of_.runs_at_once_) worker_->end(WorkerEnding::How::stopped);
    }

   private:
    FakeLauncher& of_;
    const std::shared_ptr<Worker> worker_;
  };

  std::shared_ptr<Worker> add(Worker worker) {
    ++started_;
    return workers_.emplace_back(std::make_shared<Worker>(std::move(worker)));
  }

  mutable std::mutex mutex_;
  std::vector<std::shared_ptr<Worker>> workers_;
  std::string refusal_, shortage_;
  bool runs_at_once_ = false;
  int started_ = 0;
};

}  // namespace iotcloud::topology
