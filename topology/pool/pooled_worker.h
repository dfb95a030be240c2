#pragma once

#include <functional>
#include <memory>
#include <string>
#include <thread>

#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/processes/log_file.h>
#include <iotcloud/topology/pool/worker_protocol.h>

namespace iotcloud::topology {

/// The worker's side of the connection to its pool: listens in the worker's folder, reports the worker's state, answers
/// pings, and stops the process when the pool says so. Without a pool, the worker goes on and waits for the next one.
/// Thread safe.
class PooledWorker {
 public:
  /// Listens from now on, then confines this process, which has one thread yet (worker_protocol.h).
  /// \param folder as the pool made it. \throws config::Error
  explicit PooledWorker(std::string folder);
  ~PooledWorker();

  const pooled::WorkerSpec& spec() const { return spec_; }
  const std::string& folder() const { return folder_; }
  /// Reports the state from now on.
  void show(const pooled::WorkerReport& report);
  /// Adds to the answer to a ping.
  using Probe = std::function<void(pooled::WorkerReport& answer)>;
  /// Sets what is called before each answer to a ping: it takes the locks that the worker's work takes, so that an
  /// answer proves that the worker does not hang, and says which call of a component takes long. When it returns, the
  /// one before does not run any more.
  void probe_with(Probe probe);
  /// Leaves word for the pool why this process ends. Does not throw.
  static void leave_word(const std::string& folder, bool refused, const std::string& reason) noexcept;

 private:
  void run(const std::stop_token& stop);
  void take_pool();
  bool obey();
  pooled::WorkerReport state();
  void send(const pooled::WorkerReport& report);

  const std::string folder_;
  const pooled::WorkerSpec spec_;
  const processes::LogFile log_file_;
  processes::OwnedDescriptor listener_;
  processes::Waker waker_;

  config::Mutex mutex_;
  pooled::WorkerReport report_ IOTCLOUD_GUARDED_BY(mutex_);
  config::Mutex probing_;  ///< held while the worker is probed
  Probe probe_ IOTCLOUD_GUARDED_BY(probing_);

  // Used on thread_ only.
  processes::OwnedDescriptor pool_;
  processes::FrameReader frames_;

  std::jthread thread_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::topology
