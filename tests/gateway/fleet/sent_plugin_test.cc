// Plugins that were sent, and signatures, with driver hosts as real processes.

#include <unistd.h>

#include <iotcloud/discovery/instance_name.h>
#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/fleet/process_fixture.h>
#include <iotcloud/tests/gateway/status_log.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::AllOf;
using ::testing::HasSubstr;
using tests::read_file;
namespace fs = std::filesystem;

class SentPluginTest : public ProcessTest {
 protected:
  std::shared_ptr<HostLauncher> new_launcher() override {
    security::TrustedKeys::Options trust;
    trust.require_signature = signature_required_;
    trust.trusted_keys = {write("lab.pub", lab_.public_pem)};
    processes::PluginStore::Options kept;
    kept.folder = state_ / "plugins";
    kept.trust = std::make_shared<const security::TrustedKeys>(trust);
    store_ = std::make_shared<processes::PluginStore>(kept);
    ProcessLauncher::Options options;
    options.plugin_dir = plugins_;
    options.state_dir = state_;
    options.store = store_;
    options.trust = kept.trust;
    options.host_program = HOST_PROGRAM;
    return std::make_shared<ProcessLauncher>(options);
  }
  std::string write(const std::string& name, const std::string& bytes) const {
    return tests::write_file(folder_ / name, bytes);
  }
  /// The same driver with other bytes: nobody reads what is behind the end of a library.
  std::string probe(const std::string& version) const { return read_file(plugins_ / "probe.so") + version; }
  std::string send(const std::string& bytes, const std::string& signature = "") {
    std::string sha256 = security::sha256_hex(bytes);
    const auto upload = store_->offer({"probe.so", sha256, static_cast<std::int64_t>(bytes.size()), signature});
    if (upload.empty()) return sha256;
    store_->add(upload, 0, bytes);
    store_->finish(upload);
    return sha256;
  }
  discovery::OrderRecord sent(const std::string& instance, const std::string& sha256) const {
    auto order = quiet(instance);
    order.sha256 = sha256;
    return order;
  }
  std::string signature_of(const std::string& bytes) const { return security::sign(lab_.private_pem, "lab", bytes); }
  /// Sends the version of the probe, signed as such. \return its SHA-256
  std::string signed_as(std::uint64_t version) {
    const auto bytes = probe("v" + std::to_string(version));
    return send(bytes, security::sign_plugin(lab_.private_pem, "lab", bytes, "probe", version));
  }

  bool signature_required_ = false;
  const security::KeyPair lab_ = security::new_key_pair();
  std::shared_ptr<processes::PluginStore> store_;
};

TEST_F(SentPluginTest, AnOldSignedPluginIsNotRolledBackTo) {
  signature_required_ = true;
  start_gateway();
  const auto first = signed_as(1), second = signed_as(2), third = signed_as(3);
  give(sent("a", first));
  ASSERT_TRUE(comes_to("a", DriverState::active)) << (record("a") ? record("a")->reason : "");
  give(sent("b", third));
  ASSERT_TRUE(comes_to("b", DriverState::active)) << (record("b") ? record("b")->reason : "");
  give(sent("c", second));
  ASSERT_TRUE(comes_to("c", DriverState::failed));
  EXPECT_THAT(record("c")->reason, HasSubstr("version 2 of probe is older than version 3"));
}

/// SECURITY.md: nobody knows the version of what needs no signature.
TEST_F(SentPluginTest, AnOldSignedPluginRunsWithoutItsSignatureWhereNoneIsRequired) {
  start_gateway();
  give(sent("a", signed_as(3)));
  ASSERT_TRUE(comes_to("a", DriverState::active)) << (record("a") ? record("a")->reason : "");
  give(sent("b", signed_as(2)));
  ASSERT_TRUE(comes_to("b", DriverState::failed)) << "its signature is looked at where it comes with one";
  EXPECT_THAT(record("b")->reason, HasSubstr("version 2 of probe is older than version 3"));
  give(sent("c", send(probe("v1"))));
  EXPECT_TRUE(comes_to("c", DriverState::active)) << (record("c") ? record("c")->reason : "");
}

TEST_F(SentPluginTest, OnlyAnOrderOfAnUpdateOpensTheWayBackToTheVersionBefore) {
  signature_required_ = true;
  start_gateway();
  const auto first = signed_as(1), second = signed_as(2), third = signed_as(3);
  const auto runs = [&](const std::string& sha256) {
    return eventually([&] {
      const auto now = record("a");
      return now && now->state == DriverState::active && now->sha256 == sha256;
    });
  };
  give(sent("a", first));
  ASSERT_TRUE(runs(first));
  auto update = sent("a", second);
  update.previous = sent("a", first).version();
  give(update);
  ASSERT_TRUE(runs(second));
  give(sent("a", first));
  ASSERT_TRUE(runs(first)) << "the update went back";
  give(sent("a", third));
  ASSERT_TRUE(runs(third));
  give(sent("a", second));
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_THAT(record("a")->reason, HasSubstr("version 2 of probe is older than version 3"));
}

TEST_F(SentPluginTest, WhatRulesRunNeedsASignatureToo) {
  signature_required_ = true;
  const auto bytes = probe("");
  write("plugins/probe.so.sig", security::sign_plugin(lab_.private_pem, "lab", bytes, "probe", 1));
  write("plugins/other.so.sig", signature_of("other bytes"));
  auto given = options();
  // An earlier run of the gateway had found "7" with each finder.
  given.provisioned_file = write("provisioned.jsonl", R"({"finder":"good","thing":{"key":"7","attributes":{"id":"7"}}})"
                                                      "\n");
  given.provisioning = ProvisioningRules::parse(R"(
finders:
  good: {plugin: probe.so, properties: {channels: none}}
  unsigned: {plugin: sick.so}
rules:
  first: {finder: good, where: 'id == "7"', plugin: other.so, name: "p-{id}", properties: {channels: none}}
)",
                                                "rules.yaml");
  gateway_.emplace(std::move(given));
  gateway_->start();
  const auto id = [](const std::string& name) { return discovery::named_instance_id("gw"_gateway, name, 1).str(); };
  ASSERT_TRUE(comes_to(id("good"), DriverState::active)) << (record(id("good")) ? record(id("good"))->reason : "");
  ASSERT_TRUE(comes_to(id("unsigned"), DriverState::failed, "sick"));
  EXPECT_THAT(record(id("unsigned"), "sick")->reason, HasSubstr("sick.so is not signed"));
  ASSERT_TRUE(comes_to(id("p-7"), DriverState::failed, "other"));
  EXPECT_EQ(record(id("p-7"), "other")->made_by, "rule first");
  EXPECT_THAT(record(id("p-7"), "other")->reason, HasSubstr("a key that is trusted here"));
  EXPECT_EQ(sockets().size(), 1u) << "no host was started for these";
}

TEST_F(SentPluginTest, AnInstanceRunsWhatWasSentAndItsRecordSaysWhichBytes) {
  start_gateway();
  const auto bytes = probe("v1");
  const auto sha256 = send(bytes, signature_of(bytes));
  fs::remove(plugins_ / "probe.so");  // it is not looked for there
  give(sent("a", sha256));
  ASSERT_TRUE(comes_to("a", DriverState::active)) << (record("a") ? record("a")->reason : "");
  EXPECT_EQ(record("a")->plugin, "probe.so");
  EXPECT_EQ(record("a")->sha256, sha256);
  EXPECT_EQ(record("a")->signed_by, "lab");
}

TEST_F(SentPluginTest, OtherBytesGetANewHostWhileTheOldOneServesTheOthers) {
  start_gateway();
  const auto first = send(probe("v1")), second = send(probe("v2"));
  give(sent("a", first));
  give(sent("b", first));
  ASSERT_TRUE(comes_to("a", DriverState::active) && comes_to("b", DriverState::active));
  const int process = host_process();
  ASSERT_GT(process, 0);
  give(sent("a", second));
  ASSERT_TRUE(eventually([&] {
    const auto now = record("a");
    return now && now->state == DriverState::active && now->sha256 == second;
  }));
  EXPECT_EQ(sockets().size(), 2u);
  EXPECT_EQ(kill(process, 0), 0);
  EXPECT_EQ(record("b")->sha256, first);
  give(sent("b", second));
  EXPECT_TRUE(has_ended(process)) << "the last instance of the old bytes has left it";
  EXPECT_TRUE(eventually([&] { return record("b")->sha256 == second && sockets().size() == 1; }));
}

TEST_F(SentPluginTest, AHostThatOutlivesItsGatewayTellsTheNextWhatItRuns) {
  StatusLog told;
  const auto launcher = new_launcher();
  const auto bytes = probe("v1");
  const auto sha256 = send(bytes, signature_of(bytes));
  {
    auto link = launcher->launch({"probe.so", "gw"_gateway, false, sha256, {}},
                                 {[&](const auto& status) { told.add(status); }, [](const auto&) {}});
    EXPECT_EQ(link->plugin(), (PluginIdentity{sha256, "lab", "probe"_driver}));
    InstanceSpec spec;
    spec.order = sent("a", sha256);
    spec.brokers = {{"local", "embedded", {}, {"embedded://x"}, {"embedded://x"}}};
    link->create(spec);
    ASSERT_TRUE(told.wait_for("a", DriverState::active));
  }
  const auto running = new_launcher()->running("gw"_gateway);
  ASSERT_EQ(running.size(), 1u);
  EXPECT_EQ(running[0].order.plugin, "probe.so");
  EXPECT_EQ(running[0].order.sha256, sha256);
  EXPECT_EQ(running[0].order.identity, (PluginIdentity{sha256, "lab", "probe"_driver}));
  EXPECT_EQ(running[0].instances.at(0).spec.order, sent("a", sha256));
}

TEST_F(SentPluginTest, WhatIsNotHereAnyMoreFailsWithWhatToDoAndRunsWhenItIsSentAgain) {
  start_gateway();
  const auto sha256 = security::sha256_hex(probe("v1"));
  give(sent("a", sha256));
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_THAT(record("a")->reason, AllOf(HasSubstr("is not on this gateway"), HasSubstr("iotcloud update --plugin")));
  EXPECT_EQ(record("a")->sha256, sha256);
  send(probe("v1"));
  give(sent("a", sha256));
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

TEST_F(SentPluginTest, BytesThatWereChangedInTheStoreAreNotRun) {
  start_gateway();
  const auto sha256 = send(probe("v1"));
  const auto path = store_->path_of(sha256).value();
  fs::permissions(path, fs::perms::owner_write, fs::perm_options::add);
  std::ofstream(path, std::ios::app) << "and more";
  give(sent("a", sha256));
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_THAT(record("a")->reason, HasSubstr("has another now"));
}

TEST_F(SentPluginTest, WhereSignaturesAreRequiredThePluginsOfTheFolderNeedOneToo) {
  signature_required_ = true;
  start_gateway();
  give(quiet("a"));
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_THAT(record("a")->reason, HasSubstr("probe.so is not signed"));
  std::ofstream(plugins_ / "probe.so.sig", std::ios::binary) << signature_of(probe(""));
  give(quiet("b"));
  ASSERT_TRUE(comes_to("b", DriverState::active)) << record("b")->reason;
  EXPECT_EQ(record("b")->signed_by, "lab");
  std::ofstream(plugins_ / "other.so.sig", std::ios::binary) << signature_of("something else");
  give(quiet("c", "other.so"));
  ASSERT_TRUE(comes_to("c", DriverState::failed, "other"));
  EXPECT_THAT(record("c", "other")->reason, HasSubstr("changed after it was signed"));
}

TEST_F(SentPluginTest, AFileThatChangesBetweenTheCheckAndTheHostIsRefusedByTheHost) {
  EXPECT_NO_THROW(Plugin::load_exactly(plugins_ / "probe.so", security::sha256_hex(probe("")), "probe.so"));
  try {
    Plugin::load_exactly(plugins_ / "probe.so", security::sha256_hex(probe("v1")), "probe.so");
    FAIL() << "other bytes were opened";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), AllOf(HasSubstr("probe.so"), HasSubstr("was changed after the gateway had checked it")));
  }
}

TEST_F(SentPluginTest, APluginOfAnotherSdkThatIsSentIsRefusedNamingBothSides) {
  start_gateway();
  const auto sha256 = send(read_file(plugins_ / "future_sdk.so"));
  give(sent("a", sha256));
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_THAT(record("a")->reason,
              AllOf(HasSubstr("probe.so"), HasSubstr("4711"), HasSubstr("this driver host has version")));
}

}  // namespace
}  // namespace iotcloud::gateway
