#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/fleet/process_launcher.h>
#include <iotcloud/gateway/host/protocol.h>
#include <iotcloud/processes/process_watch.h>

namespace iotcloud::gateway {

/// Of a file beside a host's socket, that says to what the host was started to connect. Hosts do not reach it.
inline constexpr std::string_view network_suffix = ".network";

/// The link to a driver host process.
class ProcessLink final : public HostLink {
 public:
  /// \param socket_name the socket's name in the state folder; the host may not listen yet. \param proof see
  /// HostProofs::of(); shown to `process` only. \param process the host.
  /// \param keep_log called about once per ping period on the link's thread; may be empty. \param files of which the
  /// host reads copies; null: it reads the brokers' files themselves
  ProcessLink(const ProcessLauncher::Options& options, const HostOrder& order, std::string socket_name,
              const std::string& proof, processes::ChildProcess process, HostEvents events,
              std::function<void()> keep_log, std::shared_ptr<const BrokerFiles> files);

  PluginIdentity plugin() const override { return order_.identity; }
  void create(const InstanceSpec& spec) override;
  void activate(const discovery::InstanceId& instance) override;
  void deactivate(const discovery::InstanceId& instance) override;
  void remove(const discovery::InstanceId& instance, Removal removal) override;
  void deliver(const PassedMessage& passed) override;
  void answer(std::int64_t number, PassAnswer answer) override;
  void renew(config::Clock::Instant confirmed) override;
  void ask(std::int64_t number, const ChannelQuestion& question) override;
  void shutdown(std::chrono::milliseconds limit) override;

 private:
  using Instant = std::chrono::steady_clock::time_point;

  void send(const protocol::HostCommand& command);
  void heard(const protocol::HostHello& hello);
  void heard(const protocol::PluginRefused& refused);
  void heard(const protocol::StatusChange& change);
  void heard(const protocol::Pong& pong);
  void heard(const protocol::HostSamples& metrics);
  void heard(const protocol::PassMessage& message);
  void heard(const protocol::AnswerMessage& answer);
  void heard(const protocol::ChannelAnswer& answer);
  void heard(const protocol::FoundMessage& found);
  void judge(const std::vector<Stall>& stalls);
  void name_after(const discovery::InstanceId& instance);
  void ping();
  void ask_for_metrics(Instant now);
  void show_metrics(std::vector<config::Sample> samples);
  void ended(const processes::WatchedEnd& end);

  const ProcessLauncher::Options options_;
  const HostOrder order_;
  const std::string socket_name_;
  const HostEvents events_;
  const std::function<void()> keep_log_;
  const std::shared_ptr<const BrokerFiles> files_;

  config::Mutex mutex_;
  std::optional<bool> answers_ IOTCLOUD_GUARDED_BY(mutex_);  ///< HostHello::answers; nullopt: no hello came yet

  // Used on the watch's thread only.
  Instant next_metrics_;
  std::string name_;               ///< the host's name in its metrics
  std::string refused_;            ///< why the host cannot serve
  discovery::InstanceId culprit_;  ///< the instance at fault when the host was killed

  processes::ProcessWatch watch_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::gateway
