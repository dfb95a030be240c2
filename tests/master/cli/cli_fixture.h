#pragma once

#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/tests/master/fleet.h>
#include <iotcloud/tests/master/process.h>
#include <iotcloud/tests/servers/free_port.h>

namespace iotcloud::master::test {

using Words = std::vector<std::string>;

/// Runs the command line as a process, against a master that serves its API.
class Cli : public ::testing::Test {
 protected:
  /// The master publishes its API's address, so the port must be known before master and server are made.
  Cli() {
    for (int attempt = 0; !server && attempt < 10; ++attempt) {
      master.reset();
      auto options = TestMaster::quick();
      rpc::ThriftServerOptions listen;
      listen.port = iotcloud::tests::free_port();
      options.address = "127.0.0.1:" + std::to_string(listen.port);
      master.emplace(url, options);
      try {
        server.emplace(listen, serve_api(**master));
      } catch (const config::Error&) {
        continue;  // another process took the port first
      }
    }
    EXPECT_TRUE(server && master->leads());
  }
  std::string address() const { return "127.0.0.1:" + std::to_string(server->port()); }

  /// Runs the CLI against the test's master.
  Finished run(std::vector<std::string> words) const {
    words.insert(words.begin(), IOTCLOUD_CLI);
    return run_program(words, {{"IOTCLOUD_MASTER", address()}});
  }
  nlohmann::json run_json(std::vector<std::string> words, int status = 0) const {
    words.insert(words.end(), {"-o", "json"});
    const auto done = run(words);
    EXPECT_EQ(done.status, status) << done.err;
    return nlohmann::json::parse(done.out);
  }
  std::string deploy(const std::string& gateway) {
    DeployRequest request;
    request.plugin = "turtle.so";
    request.gateways = {discovery::GatewayId(gateway)};
    return (*master)->deploy(request).outcomes.at(0).instance;
  }

  const std::string url = fresh_registry_url();
  std::optional<TestMaster> master;
  std::optional<rpc::ThriftServer> server;
};

}  // namespace iotcloud::master::test
