#include <iotcloud/gateway/fleet/launcher.h>

namespace iotcloud::gateway {

namespace {

class LinkToNothing final : public HostLink {
 public:
  void create(const InstanceSpec&) override {}
  void activate(const std::string&) override {}
  void deactivate(const std::string&) override {}
  void remove(const std::string&) override {}
  void shutdown(std::chrono::milliseconds) override {}
};

}  // namespace

std::unique_ptr<HostLink> link_to_nothing() {
  return std::make_unique<LinkToNothing>();
}

}  // namespace iotcloud::gateway
