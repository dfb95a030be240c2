#pragma once

#include <atomic>
#include <chrono>
#include <optional>
#include <string>
#include <thread>

#include <iotcloud/config/mutex.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/processes/silence.h>
#include <iotcloud/processes/vitals.h>
#include <iotcloud/topology/pool/worker_launcher.h>

namespace iotcloud::topology {

/// The link to a worker process: one thread connects to it, hears it, pings it, and notices its end.
class ProcessLink final : public WorkerLink {
 public:
  struct Options {
    std::string folder;  ///< of the worker; removed when it has ended
    std::chrono::milliseconds ping_period{1000};
    std::chrono::milliseconds hang_limit{10000};  ///< a worker that is silent for this long is killed
    /// A worker is killed in which a call of a component takes longer; 0: never.
    std::chrono::milliseconds call_limit{0};
  };
  /// \param process is taken over. \throws std::system_error when this process lacks descriptors or threads; then a
  /// process that was taken over has ended.
  ProcessLink(Options options, const processes::VitalLimits& limits, processes::ChildProcess& process,
              WorkerEvents events);
  ~ProcessLink() override;

  void stop(std::chrono::milliseconds limit) override;

 private:
  using Instant = std::chrono::steady_clock::time_point;

  void run() noexcept;
  bool connect();
  void converse();
  bool receive();
  bool send_stop();
  void ping();
  void watch_calls(const pooled::WorkerReport& report);
  void kill(const std::string& why);
  bool overdue(std::chrono::nanoseconds silent);
  WorkerEnding wait_for_end();

  const Options options_;
  processes::Waker waker_;
  const processes::ChildProcess process_;
  const WorkerEvents events_;
  std::atomic<bool> leaving_{false};

  config::Mutex mutex_;
  std::optional<Instant> stop_deadline_ IOTCLOUD_GUARDED_BY(mutex_);  ///< nullopt: it was not told to stop

  // Used on the link's thread only.
  processes::OwnedDescriptor socket_;
  processes::FrameReader frames_;
  Instant next_ping_;
  bool stop_sent_ = false;
  int long_calls_ = 0;  ///< reports in a row of a call that takes longer than the limit
  std::string killed_;  ///< why it was killed
  processes::Vitals vitals_;

  std::jthread thread_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::topology
