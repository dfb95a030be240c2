#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/gateway_config.h>
#include <iotcloud/processes/landlock.h>
#include <iotcloud/security/ed25519.h>

namespace iotcloud::gateway {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class GatewayConfigTest : public ::testing::Test {
 protected:
  GatewayConfigTest() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-config-XXXXXX";
    folder_ = mkdtemp(pattern.data());
  }
  ~GatewayConfigTest() override { std::filesystem::remove_all(folder_); }

  /// A good file with one line replaced or added.
  std::string with(const std::string& key, const std::string& line) const {
    std::map<std::string, std::string> lines = {
        {"id", "id: gw"},
        {"registry", "registry: \"zookeeper://127.0.0.1:2181\""},
        {"plugins", "plugins: " + folder_.string()},
        {"state", "state: " + folder_.string()},
        {"brokers", "brokers: {rabbitmq: {urls: [\"amqp://a/\", \"amqp://b/\"]}}"}};
    lines[key] = line;
    std::string text;
    for (const auto& [name, content] : lines) text += content + "\n";
    return text;
  }
  GatewayConfig load(const std::string& text) const {
    const auto file = folder_ / "gateway.yaml";
    std::ofstream(file) << text;
    return GatewayConfig::load(file);
  }
  std::string error_of(const std::string& text) const {
    try {
      load(text);
    } catch (const config::ConfigError& e) {
      return e.what();
    }
    return "";
  }

  std::filesystem::path folder_;
};

TEST_F(GatewayConfigTest, AnIdWithADotIsRefusedWhereGatewaysShareAnExchange) {
  const std::string shared = "brokers: {rabbitmq: {urls: [\"amqp://a/\"], properties: {exchange: amq.topic}}}";
  EXPECT_EQ(error_of(with("brokers", shared)), "");
  EXPECT_EQ(error_of(with("id", "id: gw.1")), "");
  // A file in which both stand: with() replaces one line.
  std::string both = with("brokers", shared);
  both.replace(both.find("id: gw"), 6, "id: gw.1");
  EXPECT_THAT(error_of(both),
              testing::AllOf(HasSubstr("gateway.yaml:2"), HasSubstr("\"gw.1\" has a dot"), HasSubstr("\"exchange\"")));
}

TEST_F(GatewayConfigTest, APasswordInABrokersUrlIsNotPublishedToAFleetWhoseProcessesHaveUsersOfTheirOwn) {
  std::ofstream(folder_ / "users") << "gateway gw:d=\n";
  std::ofstream(folder_ / "password") << "p\n";
  const std::string of_one = "\nregistry.user: gw\nregistry.password_file: " + (folder_ / "password").string() +
                             "\nregistry.users: " + (folder_ / "users").string();
  const auto brokers = [&](const std::string& url, const std::string& more) {
    return error_of(with("brokers", "brokers: {rabbitmq: {urls: [\"amqp://b/\", \"" + url + "\"]}}" + more));
  };
  EXPECT_EQ(brokers("amqp://a:sesame@b/", ""), "");
  EXPECT_EQ(brokers("amqp://a@b/", of_one), "");
  EXPECT_EQ(brokers("amqp://guest:guest@127.0.0.1/", of_one), "");
  EXPECT_THAT(brokers("amqp://a:sesame@b/", of_one), AllOf(HasSubstr("\"rabbitmq\" has its password in the URL"),
                                                           HasSubstr("password_file"), Not(HasSubstr("sesame"))));
}

TEST_F(GatewayConfigTest, AllErrorsOfAFileAreSaidAtOnce) {
  const std::string text =
      error_of(with("id", "id: \"\"\nhost_hang_limit: 3\nhost_open_files: 5\nmetrisc: {}") +
               "thrift: {port: 99999, prot: 1}\nhost_restart: {first: soon}\nlog: {level: loud}\n");
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 7) << text;
  for (const char* part :
       {"id: this must not be empty", "host_hang_limit: \"3\" is not a duration",
        "host_open_files: ", "metrisc: unknown key; did you mean \"metrics\"?", "thrift.port: \"99999\"",
        "thrift.prot: unknown key", "host_restart.first: \"soon\"", "log.level: \"loud\""}) {
    EXPECT_THAT(text, HasSubstr(part));
  }
}

TEST_F(GatewayConfigTest, WhatHostsMayTakeAndHowTheyAreStartedAgainIsRead) {
  const auto config = load(with("hosts",
                                "host_hang_limit: 3s\nhost_own_thread_hang_limit: 9s\nhost_spin_limit: 0s\n"
                                "host_memory_limit_mb: 512\nhost_restart: {first: 1s, give_up_after: 2}"));
  EXPECT_EQ(config.hosts.hang_limit, std::chrono::seconds{3});
  EXPECT_EQ(config.hosts.own_thread_hang_limit, std::chrono::seconds{9});
  EXPECT_EQ(config.hosts.limits.spin, std::chrono::seconds{0});
  EXPECT_EQ(config.hosts.limits.memory_bytes, 512u << 20);
  EXPECT_EQ(config.gateway.restart.first, std::chrono::seconds{1});
  EXPECT_EQ(config.gateway.restart.longest, std::chrono::seconds{30});
  EXPECT_EQ(config.gateway.restart.give_up_after, 2);
  EXPECT_THAT(error_of(with("hosts", "host_restart: {after: 1s}")), HasSubstr("after"));
}

TEST_F(GatewayConfigTest, WhatHostsGiveUpIsRead) {
  const auto usual = load(with("hosts", "")).hosts.confinement;
  EXPECT_TRUE(usual.no_new_privileges && usual.filter_calls && !usual.debuggable);
  EXPECT_EQ(usual.user, "");
  EXPECT_EQ(usual.open_files, 0u);
  const auto loose = load(with("hosts", "host_call_filter: false\nhost_debugging: true\nhost_open_files: 100"));
  EXPECT_TRUE(loose.hosts.confinement.debuggable && !loose.hosts.confinement.filter_calls);
  EXPECT_EQ(loose.hosts.confinement.open_files, 100u);
}

TEST_F(GatewayConfigTest, ConfinedHostsGetCopiesOfTheFilesOfTheirBrokers) {
  const std::string of_writer = folder_ / "writer", of_reader = folder_ / "reader";
  for (const auto& file : {of_writer, of_reader}) std::ofstream(file) << "sesame\n";
  const auto config =
      load(with("brokers", "brokers: {rabbitmq: {urls: [\"amqp://a/\"], user: w, password_file: " + of_writer +
                               ", properties: {reader: r, reader_password_file: " + of_reader +
                               "}}}\nhost_files: {write: [/tmp]}"));
  ASSERT_TRUE(config.hosts.confinement.files);
  EXPECT_THAT(config.hosts.broker_files, testing::UnorderedElementsAre(of_writer, of_reader));
  EXPECT_TRUE(config.hosts.confinement.files->read.empty());
}

TEST_F(GatewayConfigTest, ThePortsOfHostsAreForAllAndForSinglePlugins) {
  EXPECT_TRUE(load(with("hosts", "")).hosts.ports.empty());
  const std::string good = "host_ports: {all: [5672, 53], camera.so: [554]}";
  if (processes::landlock_version() < processes::landlock_of_connections) {
    EXPECT_THAT(error_of(with("hosts", good)), HasSubstr("cannot restrict"));
  } else {
    const ProcessLauncher::Ports expected{{"all", {5672, 53}}, {"camera.so", {554}}};
    EXPECT_EQ(load(with("hosts", good)).hosts.ports, expected);
  }
  EXPECT_THAT(error_of(with("hosts", "host_ports: {camera.so: [554]}")), HasSubstr("all: [5672]"));
  EXPECT_THAT(error_of(with("hosts", "host_ports: {all: [65536]}")), HasSubstr("no port"));
  EXPECT_THAT(error_of(with("hosts", "host_ports: {all: [amqp]}")), HasSubstr("no port"));
  EXPECT_THAT(error_of(with("hosts", "host_call_filter: false\n" + good)), HasSubstr("host_call_filter: true"));
}

TEST_F(GatewayConfigTest, ThePlacesOfHostsAreForAllAndForSinglePlugins) {
  const std::string user = geteuid() == 0 ? "host_user: nobody\n" : "";
  const std::string files = "host_files: {write: [/tmp]}\n";
  const auto refused = [&](const std::string& places, const std::string& others) {
    return error_of(with("hosts", user + others + "host_network: " + places));
  };
  EXPECT_TRUE(load(with("hosts", "")).hosts.network.empty());
  if (processes::landlock_version() == 0) {
    EXPECT_THAT(refused("{all: []}", files), HasSubstr("Landlock"));
    return;
  }
  const std::string good = "host_network: {all: [\"B:5672\"], camera.so: [\"10.0.0.7:554\", \"[::1]:80\"]}";
  const auto config = load(with("hosts", user + files + good));
  const processes::PlacesByCode expected{{"all", {{"b", 5672}}}, {"camera.so", {{"10.0.0.7", 554}, {"::1", 80}}}};
  EXPECT_EQ(config.hosts.network, expected);
  const std::vector<processes::Place> brokers{{"a", 5672}, {"b", 5672}};
  EXPECT_EQ(config.hosts.brokers_places, brokers);
  EXPECT_TRUE(load(with("hosts", user + files + "host_network: {camera.so: []}")).hosts.network.contains("all"))
      << "other plugins reach the brokers only";
  EXPECT_THAT(refused("{all: [camera-1]}", files), AllOf(HasSubstr("camera-1"), HasSubstr("HOST:PORT")));
  EXPECT_THAT(refused("{all: []}", ""), HasSubstr("host_files"));
  EXPECT_THAT(refused("{all: []}", files + "host_call_filter: false\n"), HasSubstr("host_call_filter: true"));
  if (geteuid() == 0) {
    EXPECT_THAT(error_of(with("hosts", files + "host_network: {all: []}")), HasSubstr("host_user"));
  }
  if (processes::landlock_version() < processes::landlock_of_connections) return;
  EXPECT_THAT(refused("{camera.so: [\"camera-1:554\"]}", files + "host_ports: {all: [5672], other.so: [554]}\n"),
              AllOf(HasSubstr("camera-1:554"), HasSubstr("host_ports")));
}

TEST_F(GatewayConfigTest, TheUserOfHostsMustBeThereAndHaveFewerRights) {
  EXPECT_THAT(error_of(with("hosts", "host_user: no-such-user")),
              AllOf(HasSubstr("host_user"), HasSubstr("no-such-user"), HasSubstr("gateway.yaml:")));
  EXPECT_THAT(error_of(with("hosts", "host_user: root")), AllOf(HasSubstr("host_user"), HasSubstr("root")));
  EXPECT_THAT(error_of(with("hosts", "host_open_files: 3")), AllOf(HasSubstr("host_open_files"), HasSubstr("64")));
  if (geteuid() == 0) {
    EXPECT_EQ(load(with("hosts", "host_user: nobody")).hosts.confinement.user, "nobody");
  } else {
    EXPECT_THAT(error_of(with("hosts", "host_user: nobody")), HasSubstr("only a gateway that runs as root"));
  }
  EXPECT_EQ(load(with("hosts", "host_user: nobody\nhost_starter: /run/hosts")).hosts.starter, "/run/hosts");
  EXPECT_THAT(error_of(with("hosts", "host_starter: /run/hosts")),
              AllOf(HasSubstr("host_starter"), HasSubstr("host_user")));
}

TEST_F(GatewayConfigTest, AGoodFileIsRead) {
  const auto config = load(with("thrift", "thrift: {port: 4000}"));
  EXPECT_EQ(config.gateway.id, "gw");
  EXPECT_EQ(config.gateway.port, 4000);
  EXPECT_EQ(config.gateway.brokers.at(0).type, "rabbitmq");
  EXPECT_EQ(config.gateway.brokers.at(0).options.urls.size(), 2u);
  EXPECT_EQ(config.gateway.paths.sensors, "/iot/sensors");
}

TEST_F(GatewayConfigTest, WhatIsWrongIsNamedWithItsPlace) {
  EXPECT_THAT(
      error_of(with("thrift", "thrift: {host: 0.0.0.0}")),
      AllOf(HasSubstr("thrift.host"), HasSubstr("TLS and tokens"), HasSubstr("127.0.0.1"), HasSubstr("gateway.yaml:")));
  EXPECT_THAT(error_of(with("metrics", "metrics: {address: \"0.0.0.0:1\"}")),
              AllOf(HasSubstr("metrics.address"), HasSubstr("TLS and tokens"), HasSubstr("127.0.0.1"),
                    HasSubstr("gateway.yaml:")));
  EXPECT_THAT(error_of(with("plugins", "plugins: /nowhere")), AllOf(HasSubstr("plugins"), HasSubstr("/nowhere")));
  EXPECT_THAT(error_of(with("brokers", "brokers: {mine: {type: rabbit, urls: [x]}}")), HasSubstr("rabbitmq"));
  EXPECT_THAT(error_of(with("brokers", "brokers: {mine: {type: embedded, urls: [\"embedded://x\"]}}")),
              HasSubstr("local mode"));
  EXPECT_THAT(error_of(with("id", "id: a/b")), AllOf(HasSubstr("id"), HasSubstr("slash")));
  EXPECT_THAT(error_of(with("brokerz", "brokerz: {}")), HasSubstr("did you mean \"brokers\"?"));
}

TEST_F(GatewayConfigTest, WhosePluginsRunIsRead) {
  EXPECT_EQ(load(with("thrift", "")).plugin_upload_limit, 64 << 20);
  EXPECT_FALSE(load(with("thrift", "")).hosts.trust->requires_signature());
  std::ofstream(folder_ / "lab.pub") << security::new_key_pair().public_pem;
  const std::string trusted = "plugins.trusted_keys: [" + (folder_ / "lab.pub").string() + "]\n";
  const auto config = load(with("thrift", trusted + "plugins.require_signature: true\nplugins.upload_limit_mb: 3"));
  EXPECT_TRUE(config.hosts.trust->requires_signature());
  EXPECT_EQ(config.plugin_upload_limit, 3 << 20);
  EXPECT_THAT(error_of(with("thrift", "plugins.require_signature: true")),
              AllOf(HasSubstr("plugins.require_signature"), HasSubstr("no key is trusted")));
  EXPECT_THAT(error_of(with("thrift", "plugins.trusted_keys: /nowhere.pub")),
              AllOf(HasSubstr("plugins.trusted_keys"), HasSubstr("/nowhere.pub")));
}

TEST_F(GatewayConfigTest, AVersionIsNotRequiredOfPluginsThatNeedNoSignature) {
  // Else whoever puts an old plugin there takes its signature away, and nobody looks at its version.
  for (const char* more : {"", "\nplugins.require_signature: false", "\nplugins.trust_folder: true"}) {
    EXPECT_THAT(error_of(with("thrift", std::string("plugins.require_version: true") + more)),
                AllOf(HasSubstr("plugins.require_version"), HasSubstr("plugins.require_signature: true"),
                      HasSubstr("plugins.trusted_keys")))
        << more;
  }
}

TEST_F(GatewayConfigTest, APluginFolderThatEverybodyMayWriteIsRefused) {
  std::filesystem::permissions(folder_, std::filesystem::perms::all);
  EXPECT_THAT(error_of(with("thrift", "")), AllOf(HasSubstr("plugins"), HasSubstr("chmod o-w " + folder_.string())));
}

TEST_F(GatewayConfigTest, TheFileThatWeShipIsGood) {
  std::ifstream shipped(SHIPPED_CONFIG);
  std::string text((std::istreambuf_iterator<char>(shipped)), {});
  const std::string plugins = "plugins: build/release/plugins";  // a folder that the test has not got
  ASSERT_NE(text.find(plugins), std::string::npos);
  text.replace(text.find(plugins), plugins.size(), "plugins: " + folder_.string());
  EXPECT_EQ(load(text).gateway.id, "gateway-1");
}

}  // namespace
}  // namespace iotcloud::gateway
