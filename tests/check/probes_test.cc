#include <algorithm>
#include <filesystem>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/check/probes.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/security/certificates.h>
#include <iotcloud/tests/loopback_listener.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::check {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

class Probes : public ::testing::Test {
 protected:
  Machine read(const std::string& yaml) {
    std::ofstream(file_) << yaml;
    return read_machine(file_, findings_);
  }
  /// Its state and texts; the only one of the area whose subject has these words.
  std::string found(const std::string& area, const std::string& what) const {
    for (const auto& finding : findings_) {
      if (finding.area == area && finding.what.find(what) != std::string::npos)
        return std::string(word_of(finding.state)) + ": " + finding.says + "; " + finding.mend;
    }
    return "nothing was found";
  }

  const tests::TemporaryFolder folder_;
  const std::string file_ = folder_ / "gateway.yaml";
  Findings findings_;
};

TEST_F(Probes, ReadWhatAFileNames) {
  const auto machine = read(
      "id: lab\nregistry: zookeeper://127.0.0.1:1\nthrift: {port: 12999}\nplugins: /p\nstate: /s\n"
      "metrics: {address: \"127.0.0.1:9401\"}\n"
      "brokers: {rabbitmq: {type: rabbitmq, urls: [\"amqp://127.0.0.1:1/\"], user: u, password_file: /secret}}\n");
  EXPECT_EQ(machine.kind, "gateway");
  EXPECT_EQ(machine.registry.url, "zookeeper://127.0.0.1:1");
  ASSERT_EQ(machine.listeners.size(), 2u);
  EXPECT_EQ(machine.listeners[0].port, 12999);
  EXPECT_EQ(machine.listeners[1].port, 9401);
  EXPECT_EQ(machine.folders.size(), 2u);
  EXPECT_THAT(machine.secret_files, ::testing::ElementsAre("/secret"));
}

TEST_F(Probes, ReadAnAddressOfIpv6) {
  const auto machine = read("id: lab\nregistry: embedded\nplugins: /p\nmetrics: {address: \"[::1]:9401\"}\n");
  ASSERT_EQ(machine.listeners.size(), 2u);
  EXPECT_EQ(machine.listeners[1].host, "::1");
}

TEST_F(Probes, FindTheFilesOfTopologiesToo) {
  std::filesystem::create_directory(folder_ / "topologies");
  for (const char* file : {"master.yaml", "topologies/echo.yaml", "topologies/notes.txt"})
    std::ofstream(folder_ / file) << (std::string(file) == "master.yaml" ? "api: {}\n" : "spouts: {}\n");
  EXPECT_THAT(usual_files(folder_.path()),
              ::testing::ElementsAre(folder_ / "master.yaml", folder_ / "topologies/echo.yaml"));
}

TEST_F(Probes, SayWhatIsNoDaemonsFile) {
  read("a: 1\n");
  EXPECT_THAT(found("configuration", file_), HasSubstr("wrong: it is the file of no daemon"));
  findings_.clear();
  read("a: [\n");
  EXPECT_THAT(found("configuration", file_), AllOf(HasSubstr("wrong: "), HasSubstr("correct it there")));
}

TEST_F(Probes, SayWhoHasAPort) {
  const tests::LoopbackListener listener;
  Machine machine{.file = file_, .kind = "gateway"};
  machine.listeners = {{"thrift", "127.0.0.1", listener.port()}, {"api", "192.0.2.1", 12904}};
  check_ports(machine, findings_);
  EXPECT_THAT(found("port", "thrift"),
              AllOf(HasSubstr("wrong: "), HasSubstr("check_test"), HasSubstr("give thrift another port")));
  EXPECT_THAT(found("port", "api"),
              AllOf(HasSubstr("wrong: cannot be opened"), HasSubstr("it is no address of this machine")));
}

TEST_F(Probes, SayWhichFolderIsNotThere) {
  Machine machine{.file = file_, .kind = "gateway"};
  machine.folders = {{"plugins", folder_ / "none"}, {"state", folder_.path()}};
  check_disk(machine, findings_);
  EXPECT_THAT(found("disk", "none"), HasSubstr("wrong: No such file or directory; make it, or name another folder"));
  EXPECT_THAT(found("disk", folder_.path() + " (state"), HasSubstr("free"));
}

TEST_F(Probes, SayWhenCertificatesEndAndWhoseKeysTheyHave) {
  const security::Authority authority{folder_ / "authority"};
  authority.make();
  authority.certify_host("lab1");
  authority.certify_host("lab2");
  Machine machine{.file = file_, .kind = "gateway"};
  machine.tls = {{"thrift.tls", {authority.certificate("ca"), authority.certificate("lab1"), authority.key("lab1")}}};
  const std::int64_t now = config::system_clock().wall_ms() / 1000;
  check_certificates(machine, now, findings_);
  EXPECT_THAT(found("certificate", "lab1.pem"), AllOf(HasSubstr("ok: it ends in"), HasSubstr("days")));
  EXPECT_THAT(found("certificate", "ca.pem"), HasSubstr("ok: the authority ends in"));
  EXPECT_THAT(found("certificate", "lab1.key"), HasSubstr("ok: "));
  constexpr std::int64_t day = 86'400;
  for (const auto& [later, expected] : {std::pair<std::int64_t, const char*>{720 * day, "warning: it ends in"},
                                        {800 * day, "wrong: it ended"},
                                        {-2 * day, "wrong: it is not valid yet"}}) {
    findings_.clear();
    check_certificates(machine, now + later, findings_);
    EXPECT_THAT(found("certificate", "lab1.pem"), HasSubstr(expected));
  }
  findings_.clear();
  machine.tls[0].second.key = authority.key("lab2");
  check_certificates(machine, now, findings_);
  EXPECT_THAT(found("certificate", "lab2.key"), HasSubstr("wrong: it is not the key of the certificate beside it"));
  findings_.clear();
  machine.tls[0].second = {folder_ / "none.pem", file_, authority.key("lab1")};
  std::ofstream(file_) << "no certificate";
  std::filesystem::permissions(authority.key("lab1"), std::filesystem::perms::others_read,
                               std::filesystem::perm_options::add);
  check_certificates(machine, now, findings_);
  EXPECT_THAT(found("certificate", "none.pem"), HasSubstr("wrong: it cannot be read: No such file"));
  EXPECT_THAT(found("certificate", file_), HasSubstr("wrong: it is no certificate"));
  EXPECT_THAT(found("certificate", "lab1.key"), AllOf(HasSubstr("warning: everybody"), HasSubstr("chmod o-rwx")));
}

TEST_F(Probes, SayWhichPluginIsOfAnotherSdk) {
  const auto plugin = [&](const std::string& name, const std::string& bytes) {
    std::ofstream(folder_ / name) << bytes;
  };
  plugin("good.so", IOTCLOUD_DRIVER_SDK_MARK + std::to_string(drivers::sdk_version) + ";");
  plugin("old.so", std::string(IOTCLOUD_DRIVER_SDK_MARK) + "1;");
  plugin("other.so", "ELF");
  plugin("readme.txt", "no plugin");
  Machine machine{.file = file_, .kind = "gateway"};
  machine.folders = {{"plugins", folder_.path()}};
  check_plugins(machine, findings_);
  EXPECT_THAT(found("plugin", "good.so"), HasSubstr("ok: driver SDK"));
  EXPECT_THAT(found("plugin", "old.so"),
              AllOf(HasSubstr("wrong: driver SDK 1, and this installation has"), HasSubstr("build it again")));
  EXPECT_THAT(found("plugin", "other.so"), HasSubstr("warning: it does not say"));
  EXPECT_EQ(found("plugin", "readme.txt"), "nothing was found");
}

TEST_F(Probes, SayWhichServerDoesNotAnswer) {
  auto machine = read(
      "id: lab\nregistry: zookeeper://127.0.0.1:1\nregistry.open: true\nplugins: /p\nstate: /s\n"
      "brokers: {rabbitmq: {urls: [\"amqp://guest:hunter22@127.0.0.1:1/\"]}}\n");
  check_registry(machine, 200ms, findings_);
  check_brokers(machine, 200ms, findings_);
  EXPECT_THAT(found("registry", "127.0.0.1:1"),
              AllOf(HasSubstr("wrong: no answer within 200 ms"), HasSubstr("start ZooKeeper")));
  EXPECT_THAT(found("broker", "rabbitmq amqp://guest:***@127.0.0.1:1"),
              AllOf(HasSubstr("wrong: "), HasSubstr("correct brokers.rabbitmq")));
  findings_.clear();
  machine.registry.url = "embedded://x";
  machine.brokers["rabbitmq"].urls = {"embedded://x"};
  check_registry(machine, 200ms, findings_);
  check_brokers(machine, 200ms, findings_);
  EXPECT_TRUE(findings_.empty());
}

TEST_F(Probes, LookAtTheClock) {
  check_clock(findings_);
  EXPECT_NE(found("clock", "this machine's"), "nothing was found");
}

}  // namespace
}  // namespace iotcloud::check
