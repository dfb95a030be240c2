#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/master/master_service.h>

int main(int argc, char** argv) {
  iotcloud::config::DaemonOptions options;
  options.name = "iotcloud-master";
  options.description =
      "The gateway master: takes orders for a fleet of gateways and answers with what became of them.";
  options.build = [](const std::string& file) {
    return iotcloud::master::make_master_service(iotcloud::master::load_master_config(file));
  };
  return iotcloud::config::run_daemon(argc, argv, options);
}
