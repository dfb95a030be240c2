#include <algorithm>
#include <cstdio>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/master_service.h>
#include <iotcloud/tests/servers/free_port.h>

namespace iotcloud::master {
namespace {

using testing::AllOf;
using testing::HasSubstr;

/// A configuration file that goes with the test.
class ConfigFile {
 public:
  explicit ConfigFile(const std::string& text)
      : path_(testing::TempDir() + "iotcloud-master-" + std::to_string(getpid()) + ".yaml") {
    std::ofstream(path_) << text;
  }
  ~ConfigFile() { std::remove(path_.c_str()); }
  const std::string& path() const { return path_; }

 private:
  const std::string path_;
};

std::string error_of(const std::string& text) {
  const ConfigFile file(text);
  try {
    load_master_config(file.path());
    return "";
  } catch (const config::ConfigError& e) {
    return e.what();
  }
}

TEST(MasterConfig, TheShippedFileIsGood) {
  const auto config = load_master_config(IOTCLOUD_SOURCE_DIR "/config/master.yaml");
  EXPECT_EQ(config.api.port, 12904);
  EXPECT_FALSE(config.gateways);
  EXPECT_EQ(config.sensors_root, "/iot/sensors");
}

TEST(MasterConfig, AllErrorsOfAFileAreSaidAtOnce) {
  const std::string text = error_of(
      "registri: x\napi: {port: none, token: x}\norders: {wait: 5, for_lost_gateways: recrd}\nlog: {format: xml}\n");
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 6) << text;
  for (const char* part : {"the key \"registry\" is missing", "registri: unknown key; did you mean \"registry\"?",
                           "api.port: \"none\"", "api.token: unknown key; did you mean \"tokens\"?",
                           "orders.wait: \"5\" is not a duration", "did you mean \"record\"?", "log.format: \"xml\""}) {
    EXPECT_THAT(text, testing::HasSubstr(part));
  }
}

TEST(MasterConfig, ThePortForGatewaysOfTheOriginalIsOnOnlyIfItsKeyIsThere) {
  const ConfigFile without("registry: \"embedded://a\"\n");
  EXPECT_FALSE(load_master_config(without.path()).gateways);
  const ConfigFile with("registry: \"embedded://a\"\ngateways: {}\n");
  const auto config = load_master_config(with.path());
  ASSERT_TRUE(config.gateways);
  EXPECT_EQ(config.gateways->host, "127.0.0.1");
  EXPECT_EQ(config.gateways->port, 12903);
}

TEST(MasterConfig, TheConsoleIsOffWithoutItsKeyAndForOtherMachinesOnlyWithTlsAndTokens) {
  const ConfigFile without("registry: \"embedded://a\"\n");
  EXPECT_EQ(load_master_config(without.path()).console.pages.address, "");
  const ConfigFile with("registry: \"embedded://a\"\nconsole: {address: \"127.0.0.1:9114\", idle: 5m}\n");
  EXPECT_EQ(load_master_config(with.path()).console.idle, std::chrono::minutes(5));
  const auto console = [](const std::string& keys) {
    return error_of("registry: \"embedded://a\"\nconsole: {" + keys + "}\n");
  };
  EXPECT_THAT(console("address: \"0.0.0.0:9114\""),
              AllOf(HasSubstr("TLS and tokens"), HasSubstr("iotcloud token add")));
  EXPECT_THAT(console("adress: x"), AllOf(HasSubstr("console.adress"), HasSubstr("did you mean")));
  EXPECT_THAT(console("address: \"127.0.0.1:1\", others: [\"https://lab2:1; script-src *\"]"),
              HasSubstr("is not the address of a console"));
  EXPECT_THAT(console("address: \"127.0.0.1:1\", pages: {folder: /none}"), HasSubstr("is no folder"));
  EXPECT_THAT(console("address: \"127.0.0.1:1\", pages: {folder: /tmp, require_signature: true}"),
              AllOf(HasSubstr("console.pages.require_signature"), HasSubstr("trust")));
  EXPECT_THAT(console("address: \"127.0.0.1:1\", pages: {folder: /tmp, versions: /tmp/versions}"),
              AllOf(HasSubstr("console.pages.versions"), HasSubstr("require_signature")));
  EXPECT_THAT(console("address: \"127.0.0.1:1\", pages: {folder: /tmp, require_version: true}"),
              AllOf(HasSubstr("console.pages.require_version"), HasSubstr("versions: FILE")));
}

TEST(MasterConfig, OnlyTheRegistryIsNeeded) {
  const ConfigFile file("registry: \"embedded://a\"\n");
  const auto config = load_master_config(file.path());
  EXPECT_EQ(config.api.host, "127.0.0.1");
  EXPECT_EQ(config.api.advertise, "127.0.0.1:12904");
  EXPECT_THAT(error_of("id: m\n"), HasSubstr("registry"));
}

TEST(MasterConfig, AnAddressThatOthersCanReachIsRefusedWithTheReason) {
  for (const char* section : {"api", "gateways"}) {
    const auto text = error_of("registry: \"embedded://a\"\n" + std::string(section) + ": {host: 0.0.0.0}\n");
    EXPECT_THAT(text, AllOf(HasSubstr(":2:"), HasSubstr(std::string(section) + ".host"), HasSubstr("TLS"),
                            HasSubstr("127.0.0.1")));
  }
  EXPECT_THAT(error_of("registry: \"embedded://a\"\nmetrics: {address: \"0.0.0.0:1\"}\n"),
              AllOf(HasSubstr(":2:"), HasSubstr("metrics.address"), HasSubstr("TLS"), HasSubstr("127.0.0.1")));
}

TEST(MasterConfig, AnUnknownKeyIsNamedWithItsPlace) {
  EXPECT_THAT(error_of("registry: \"embedded://a\"\napi: {prot: 1}\n"), AllOf(HasSubstr(":2:"), HasSubstr("port")));
  EXPECT_THAT(error_of("registry: \"embedded://a\"\norders: {wait: 30}\n"), HasSubstr("orders.wait"));
}

TEST(MasterConfig, ATokenFileThatCannotBeReadIsAnErrorThatSaysHowToMakeOne) {
  EXPECT_THAT(error_of("registry: \"embedded://a\"\napi: {tokens: /nonexistent/tokens}\n"),
              AllOf(HasSubstr("/nonexistent/tokens"), HasSubstr("iotcloud token add")));
}

TEST(MasterConfig, CertificatesThatCannotBeUsedAreAnErrorThatNamesTheFile) {
  EXPECT_THAT(error_of("registry: \"embedded://a\"\napi: {tls: {ca: /nonexistent/ca.pem, certificate: b, key: c}}\n"),
              AllOf(HasSubstr("api.tls"), HasSubstr("/nonexistent/ca.pem"), HasSubstr("iotcloud certs init")));
  EXPECT_THAT(error_of("registry: \"embedded://a\"\napi: {tls: {ca: a}}\n"),
              AllOf(HasSubstr("api.tls"), HasSubstr("certificate")));
}

TEST(MasterService, StartsAndStopsAndMayBeStartedAnew) {
  MasterDaemonConfig config;
  config.id = "m1";
  config.registry.url = "embedded://master-service-" + std::to_string(getpid());
  config.sensors_root = "/iot/sensors";
  config.api.port = 0;
  for (int i = 0; i < 2; ++i) {
    auto service = make_master_service(config);
    service->start();
    service->stop(std::chrono::seconds(5));
  }
}

TEST(MasterService, APortInUseStopsTheStartCleanly) {
  MasterDaemonConfig config;
  config.registry.url = "embedded://master-service-" + std::to_string(getpid());
  config.sensors_root = "/iot/sensors";
  config.api.port = 0;
  config.gateways = rpc::ListenSettings{"127.0.0.1", tests::free_port(), {}, "", ""};
  auto first = make_master_service(config);
  first->start();
  auto second = make_master_service(config);
  EXPECT_THROW(second->start(), config::Error);
  second.reset();
  first->stop(std::chrono::seconds(5));
}

}  // namespace
}  // namespace iotcloud::master
