#include <cstdio>
#include <exception>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <unistd.h>

#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/robot/address.h>
#include <iotcloud/drivers/turtle/robot/agent.h>
#include <iotcloud/drivers/turtle/standalone/device_host.h>

namespace turtle = iotcloud::drivers::turtle;
namespace robot = iotcloud::drivers::turtle::robot;

namespace {

/// Reads the first line of a file. \throws std::runtime_error.
std::string read_token(const std::string& path) {
  std::ifstream file(path);
  std::string token;
  if (!std::getline(file, token) || token.empty()) throw std::runtime_error("there is no token in " + path);
  return token;
}

std::string host_name() {
  char name[robot::most_name_bytes + 1] = {};
  return gethostname(name, sizeof name - 1) == 0 ? name : "robot";
}

/// Refuses properties that configure the driver in the gateway: they belong in its deployment.
void refuse_driver_s(const iotcloud::drivers::PropertyMap& properties) {
  for (const char* name : {"broker", "frames", "trace"}) {
    if (properties.contains(name)) {
      throw std::invalid_argument(std::string("property \"") + name +
                                  "\" is the turtle driver's in the gateway: deploy it there");
    }
  }
}

}  // namespace

/// Runs the agent on a robot's laptop until SIGTERM or SIGINT. Exit status 0: stopped; 1: failed; 2: wrong arguments.
int main(int argc, char** argv) {
  CLI::App app{
      "Reads a robot's depth frames, compresses them and sends the newest to the turtle driver in a gateway; gives "
      "the\n"
      "commands that come back to the robot's base, and stops it when none come.",
      "iotcloud-robot"};
  app.footer(
      "examples:\n"
      "  iotcloud-robot --driver gateway.lan:7411 --token-file /etc/iotcloud/robot.token --source kinect\n"
      "  iotcloud-robot --driver 127.0.0.1:7411 --source simulator --property seed=3\n"
      "The driver: iotcloud deploy turtle.so --property source=robot --property listen=0.0.0.0:7411 --property "
      "token=...");
  robot::AgentOptions options;
  options.name = host_name();
  std::string source = "kinect", actuator, token_file;
  std::vector<std::string> words;
  int watchdog_ms = 250, silence_ms = 0;
  app.add_option("--driver", options.driver, "host:port of the turtle driver")->required();
  app.add_option("--source", source, "a kind of the turtle driver's sources")->capture_default_str();
  app.add_option("--actuator", actuator,
                 "a kind of the turtle driver's actuators (default: that of the source, `none` if it has none)");
  app.add_option("--property", words, "key=value of source and actuator, as for the turtle driver; may be repeated")
      ->allow_extra_args(false);
  app.add_option("--token-file", token_file,
                 "a file with the driver's token; needed unless the driver is on this machine")
      ->check(CLI::ExistingFile);
  app.add_option("--watchdog-ms", watchdog_ms, "stop the robot when no command came for this long")
      ->check(CLI::Range(20, 10'000))
      ->capture_default_str();
  app.add_option("--silence-ms", silence_ms,
                 "give up a connection on which nothing came for this long (default: that of --watchdog-ms)")
      ->check(CLI::Range(20, 60'000));
  app.add_option("--in-flight", options.in_flight,
                 "how many frames may be under way that the driver has not acknowledged")
      ->check(CLI::Range(1, 16))
      ->capture_default_str();
  app.add_option("--name", options.name, "this robot's name in the driver's log")->capture_default_str();
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }

  const auto log = turtle::log_to_stderr("iotcloud-robot");
  try {
    robot::split_address(options.driver);
    if (!token_file.empty()) options.token = read_token(token_file);
    robot::check_token(options.driver, options.token, "--token-file");
    options.silence = std::chrono::milliseconds(silence_ms > 0 ? silence_ms : watchdog_ms);
    auto properties = turtle::parse_properties(words);
    refuse_driver_s(properties);
    properties["source"] = source;
    if (!actuator.empty()) properties["actuator"] = actuator;
    properties["watchdog_ms"] = std::to_string(watchdog_ms);
    const auto device_options = turtle::read_options(properties, turtle::shipped_kinds());

    boost::asio::io_context loop;
    boost::asio::signal_set signals(loop, SIGINT, SIGTERM);
    signals.async_wait([&](const boost::system::error_code&, int) { loop.stop(); });
    std::string failure;
    turtle::DeviceHost host(loop, properties, log, [&](const std::string& reason) {
      failure = reason;
      loop.stop();
    });
    iotcloud::drivers::DriverContext context(host);
    robot::Agent agent(loop, options, device_options, context);
    agent.start();
    loop.run();
    agent.stop();
    if (!failure.empty()) throw std::runtime_error(failure);
    return 0;
  } catch (const std::exception& e) {
    log(iotcloud::drivers::LogLevel::error, e.what());
    return 1;
  }
}
