#pragma once

#include <chrono>
#include <functional>
#include <string>

#include <iotcloud/processes/process_watch.h>
#include <iotcloud/topology/pool/worker_launcher.h>

namespace iotcloud::topology {

/// The link to a worker process.
class ProcessLink final : public WorkerLink {
 public:
  struct Options {
    std::string folder;  ///< of the worker; removed when it has ended
    std::chrono::milliseconds ping_period{1000};
    std::chrono::milliseconds hang_limit{10000};  ///< a worker that is silent for this long is killed
    /// A worker is killed in which a call of a component takes longer; 0: never.
    std::chrono::milliseconds call_limit{0};
    std::function<void()> keep_log;  ///< called about once in a ping period, on the link's thread; may be empty
  };
  /// As processes::ProcessWatch().
  ProcessLink(Options options, const processes::VitalLimits& limits, processes::ChildProcess process,
              WorkerEvents events);

  void stop(std::chrono::milliseconds limit) override;

 private:
  void heard(const pooled::WorkerReport& report);
  void ended(const processes::WatchedEnd& end);

  const Options options_;
  const WorkerEvents events_;
  int long_calls_ = 0;  ///< reports in a row of a call that takes longer than the limit; of the watch's thread
  processes::ProcessWatch watch_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::topology
