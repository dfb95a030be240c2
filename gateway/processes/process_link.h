#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <iotcloud/gateway/host/control/protocol.h>
#include <iotcloud/gateway/host/control/unix_socket.h>
#include <iotcloud/gateway/processes/process_launcher.h>

namespace iotcloud::gateway {

/// The link to a driver host process: one thread that connects to it, sends, receives, pings, and sees it end.
class ProcessLink final : public HostLink {
 public:
  /// \param socket_name in the state folder; the host may not listen yet. \param process its id.
  /// \param child whether it is this process's child, whose exit status can be had.
  /// \param keep_log called about once in each ping period, on the link's thread; may be empty.
  ProcessLink(const ProcessLauncher::Options& options, const HostOrder& order, std::string socket_name, int process,
              bool child, HostEvents events, std::function<void()> keep_log);
  ~ProcessLink() override;

  PluginIdentity plugin() const override { return order_.identity; }
  void create(const InstanceSpec& spec) override;
  void activate(const std::string& instance) override;
  void deactivate(const std::string& instance) override;
  void remove(const std::string& instance) override;
  void shutdown(std::chrono::milliseconds limit) override;

 private:
  using Instant = std::chrono::steady_clock::time_point;

  void send(const protocol::Command& command);
  void run() noexcept;
  bool connect();
  void converse();
  bool send_waiting();
  bool receive();
  void heard(const protocol::Event& event);
  void judge(const std::vector<Stall>& stalls);
  void name_after(const std::string& instance);
  void ping();
  void ask_for_metrics(Instant now);
  void show_metrics(std::vector<config::Sample> samples);
  bool overdue(std::chrono::nanoseconds silent);
  std::chrono::milliseconds time_to_wait() const;
  void kill_process();
  HostEnd wait_for_end();
  void tell_end(const HostEnd& end);

  const ProcessLauncher::Options options_;
  const HostOrder order_;
  const std::string socket_name_;
  const int process_;
  const bool child_;
  const HostEvents events_;
  const std::function<void()> keep_log_;
  OwnedDescriptor process_descriptor_;  ///< readable when the process has ended
  Waker waker_;
  std::atomic<bool> leaving_{false};

  std::mutex mutex_;
  std::vector<std::string> waiting_;            ///< frames to send; guarded by mutex_
  bool shutting_down_ = false;                  ///< guarded by mutex_
  Instant shutdown_deadline_ = Instant::max();  ///< guarded by mutex_

  // The link's thread only.
  OwnedDescriptor socket_;
  protocol::FrameReader frames_;
  Instant next_ping_, next_metrics_;
  std::string name_;     ///< of the host, in its metrics
  std::string refused_;  ///< why the host cannot serve
  std::string killed_;   ///< why it was killed
  std::string culprit_;  ///< the instance because of which
  Vitals vitals_;

  std::jthread thread_;  ///< last: uses the rest
};

}  // namespace iotcloud::gateway
