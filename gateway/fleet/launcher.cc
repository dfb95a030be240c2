#include <iotcloud/gateway/fleet/launcher.h>

namespace iotcloud::gateway {

namespace {

class LinkToNothing final : public HostLink {
 public:
  void create(const InstanceSpec&) override {}
  void activate(const discovery::InstanceId&) override {}
  void deactivate(const discovery::InstanceId&) override {}
  void remove(const discovery::InstanceId&, Removal) override {}
  void shutdown(std::chrono::milliseconds) override {}
};

}  // namespace

std::unique_ptr<HostLink> link_to_nothing() {
  return std::make_unique<LinkToNothing>();
}

}  // namespace iotcloud::gateway
