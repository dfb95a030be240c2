#include <exception>
#include <thread>

#include <fmt/format.h>

#include <iotcloud/gateway/fleet/in_process_launcher.h>

namespace iotcloud::gateway {

namespace {

class InProcessLink final : public HostLink {
 public:
  InProcessLink(DriverHost::Options options, std::shared_ptr<const Plugin> plugin, HostEvents events)
      : events_(std::move(events)), host_(std::move(options), std::move(plugin), events_.on_status) {}

  void create(const InstanceSpec& spec) override { host_.create(spec); }
  void activate(const std::string& instance) override { host_.activate(instance); }
  void deactivate(const std::string& instance) override { host_.deactivate(instance); }
  void remove(const std::string& instance) override { host_.remove(instance); }
  void shutdown(std::chrono::milliseconds limit) override {
    if (stopper_.joinable()) return;
    stopper_ = std::jthread([this, limit] {
      HostEnd end;
      if (!host_.stop(limit)) end.reason = "a driver is stuck in a callback; its thread was left behind";
      events_.on_ended(end);
    });
  }

 private:
  const HostEvents events_;
  DriverHost host_;
  std::jthread stopper_;  ///< last: joined first
};

}  // namespace

std::unique_ptr<HostLink> InProcessLauncher::launch(const HostOrder& order, HostEvents events) {
  std::shared_ptr<const Plugin> plugin;
  try {
    check_plugin_file_name(order.plugin);
    if (!order.sha256.empty())
      throw config::Error(order.plugin + " was sent, and a gateway inside a process keeps no plugins that are sent");
    const auto linked_in = options_.linked_in.find(order.plugin);
    plugin = linked_in != options_.linked_in.end() ? Plugin::wrap(*linked_in->second, order.plugin)
                                                   : Plugin::load(options_.plugin_dir + "/" + order.plugin);
  } catch (const std::exception& e) {
    events.on_ended({HostEnd::How::refused, e.what(), ""});
    return link_to_nothing();
  }
  DriverHost::Options host;
  host.gateway = order.gateway;
  host.isolated = order.isolated;
  host.state_folder = options_.state_dir;
  host.clock = options_.clock;
  host.metrics = options_.metrics;
  return std::make_unique<InProcessLink>(std::move(host), std::move(plugin), std::move(events));
}

std::unique_ptr<HostLink> InProcessLauncher::adopt(const RunningHost& host, HostEvents events) {
  return launch(host.order, std::move(events));  // there is none to adopt: running() is empty
}

}  // namespace iotcloud::gateway
