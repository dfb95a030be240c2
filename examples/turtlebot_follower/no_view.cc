#include <iotcloud/config/error.h>
#include <iotcloud/examples/turtlebot_follower/view.h>

std::unique_ptr<View> show(iotcloud::local::LocalCluster& /*cluster*/, const std::string& /*address*/,
                           const std::vector<std::string>& /*pages*/) {
  throw iotcloud::config::Error("--view: this program has no page; turtlebot-demo-view has (./dev demo --view)");
}
