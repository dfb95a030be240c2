#include <iotcloud/examples/turtlebot_follower/view.h>
#include <iotcloud/topology/local/local_console.h>

namespace {

class ConsoleView final : public View {
 public:
  ConsoleView(iotcloud::local::LocalCluster& cluster, const std::string& address, const std::vector<std::string>& pages)
      : console_(cluster, address, pages) {}
  std::string url() const override { return console_.url(); }

 private:
  const iotcloud::local::LocalConsole console_;
};

}  // namespace

std::unique_ptr<View> show(iotcloud::local::LocalCluster& cluster, const std::string& address,
                           const std::vector<std::string>& pages) {
  return std::make_unique<ConsoleView>(cluster, address, pages);
}
