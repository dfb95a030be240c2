// deploy and update with a plugin of this machine, keys and signatures: what the command line sends, by way of the
// master, to gateways' Thrift services.
#include <filesystem>

#include <gmock/gmock.h>
#include <sys/stat.h>

#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/master/cli/cli_fixture.h>
#include <iotcloud/tests/master/cli/receiving_gateway.h>
#include <iotcloud/tests/servers/free_port.h>

namespace iotcloud::master::test {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;
using tests::read_file;

class CliPlugin : public Cli {
 protected:
  CliPlugin() {
    std::string pattern = fs::temp_directory_path() / "iotcloud-cli-plugin-XXXXXX";
    folder_ = mkdtemp(pattern.data());
  }
  ~CliPlugin() override { fs::remove_all(folder_); }

  std::string write(const std::string& name, const std::string& bytes) const {
    return tests::write_file(folder_ / name, bytes);
  }

  fs::path folder_;
  ServedGateway lab1_{url, "lab1"}, lab2_{url, "lab2"};
};

TEST_F(CliPlugin, AFileIsSentInPiecesToEveryGatewayAndDeployedByItsContent) {
  std::string bytes(1'300'000, '\0');
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i * 31);
  const auto path = write("turtle.so", bytes);
  const auto outcomes = run_json({"deploy", "--plugin", path, "--all"})["outcomes"];
  ASSERT_THAT(outcomes, SizeIs(2));
  for (auto* lab : {&lab1_, &lab2_}) {
    EXPECT_EQ(lab->site->received(), bytes);
    EXPECT_EQ(lab->site->pieces(), 3);
    EXPECT_EQ(lab->site->offer().plugin, "turtle.so");
    EXPECT_EQ(lab->site->offer().size, 1'300'000);
    EXPECT_EQ(lab->gateway.orders().at(0).plugin, "turtle.so");
    EXPECT_EQ(lab->gateway.orders().at(0).sha256, security::sha256_hex(bytes));
  }
  const auto again = run({"deploy", path, "--gateway", "lab1"});
  EXPECT_EQ(again.status, 0) << again.err;
  EXPECT_THAT(again.err, Not(HasSubstr("sending"))) << "progress is for terminals";
  EXPECT_EQ(lab1_.site->received(), "") << "it has the plugin already";
}

TEST_F(CliPlugin, ABackupNamesWhatWasSentAndImportSendsItToGatewaysThatLostIt) {
  const auto path = write("turtle.so", "turtle");
  ASSERT_EQ(run({"deploy", "--plugin", path, "--all"}).status, 0);
  const auto backup = (folder_ / "backup.json").string();
  const auto named = AllOf(HasSubstr("turtle.so (SHA-256 " + security::sha256_hex("turtle").substr(0, 12)),
                           HasSubstr("gateways lab1, lab2)"));
  const auto written = run({"registry", "export", backup});
  EXPECT_THAT(written.err, named);
  EXPECT_THAT(read_file(backup), HasSubstr("missing_plugins"));

  EXPECT_THAT(run({"registry", "import", backup}).err, AllOf(named, HasSubstr("--plugin FILE")));
  lab2_.site->forget();
  const auto sent = run({"registry", "import", backup, "--plugin", path});
  EXPECT_EQ(sent.status, 0) << sent.err;
  EXPECT_EQ(sent.err, "");
  EXPECT_EQ(lab1_.site->received(), "") << "it has the plugin already";
  EXPECT_EQ(lab2_.site->received(), "turtle");

  lab2_.site->forget();
  lab2_.site->refuse_with("the disk is full");
  const auto refused = run({"registry", "import", backup, "--plugin", path});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.out, HasSubstr("turtle.so: the disk is full"));
  const auto other = run({"registry", "import", backup, "--plugin", write("meter.so", "meter")});
  EXPECT_EQ(other.status, 2);
  EXPECT_THAT(other.err, HasSubstr("no order of " + backup + " names a plugin"));
}

TEST_F(CliPlugin, AFileForAGatewayGoesToNobodyWhoseRecordSaysThatItIsThatGateways) {
  const auto thief = std::make_shared<ReceivingSite>("lab1");
  const rpc::ThriftServer service(
      {}, [p = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(thief)](const auto&) { return p; });
  const FakeGateway seized(url, "aaa");  // comes before the others
  serve_at(url, "aaa", service.port());
  const discovery::Paths paths;
  const auto registry = open_registry(url);
  auto record = discovery::decode_gateway(registry->get(paths.gateway("aaa"_gateway))->data, "aaa");
  record.id = "lab1"_gateway;
  discovery::put(*registry, paths.gateway("aaa"_gateway), encode(record));
  const auto done = run({"deploy", "--plugin", write("turtle.so", "secret"), "--gateway", "lab1"});
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_EQ(lab1_.site->received(), "secret");
  EXPECT_EQ(thief->offers(), 0u);
}

TEST_F(CliPlugin, APlainNameIsAFileOfTheGatewaysWhateverFilesAreHere) {
  const auto done = run({"deploy", "turtle.so", "--gateway", "lab1"});
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_EQ(lab1_.gateway.orders().at(0).sha256, "");
  EXPECT_EQ(lab1_.site->offers(), 0u);
}

TEST_F(CliPlugin, AGatewayThatDoesNotTakeItIsAFailedOutcomeAndTheOthersRunIt) {
  lab2_.site->refuse_with("turtle.so is not signed");
  const auto done = run({"deploy", "--plugin", write("turtle.so", "abc"), "--all"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, AllOf(HasSubstr("done"), HasSubstr("lab2"), HasSubstr("failed"), HasSubstr("is not signed")));
  EXPECT_THAT(lab1_.gateway.orders(), SizeIs(1));
  EXPECT_THAT(lab2_.gateway.orders(), SizeIs(0));
}

TEST_F(CliPlugin, AGatewayThatCannotBeReachedIsNamed) {
  const FakeGateway far(url, "far");
  serve_at(url, "far", tests::free_port());
  const auto done = run({"deploy", "--plugin", write("turtle.so", "abc"), "-g", "far"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, AllOf(HasSubstr("far"), HasSubstr("failed"), HasSubstr("does not answer")));
  EXPECT_THAT(far.orders(), SizeIs(0));
}

TEST_F(CliPlugin, TheSignatureBesideAFileGoesWithIt) {
  ASSERT_EQ(run({"keys", "new", folder_ / "lab"}).status, 0);
  const auto path = write("turtle.so", "abc");
  const auto signing = run({"sign", path, "--key", folder_ / "lab.key"});
  EXPECT_EQ(signing.status, 0) << signing.err;
  EXPECT_THAT(signing.out, HasSubstr(security::sha256_hex("abc")));
  EXPECT_EQ(run_json({"sign", path, "--key", folder_ / "lab.key"})["sha256"], security::sha256_hex("abc"));
  ASSERT_EQ(run({"deploy", "--plugin", path, "-g", "lab1"}).status, 0);
  const auto key = security::PublicKey::from_pem(read_file(folder_ / "lab.pub"), "lab.pub");
  EXPECT_TRUE(key.verifies("abc", lab1_.site->offer().signature));
  write("turtle.so.sig", "short");
  const auto done = run({"deploy", "--plugin", path, "-g", "lab1"});
  EXPECT_EQ(done.status, 2);
  EXPECT_THAT(done.err, AllOf(HasSubstr("turtle.so.sig has 5 bytes"), HasSubstr("iotcloud sign")));
}

TEST_F(CliPlugin, ANewKeyIsItsOwnersAloneAndNeverTakesAnothersPlace) {
  ASSERT_EQ(run({"keys", "new", folder_ / "lab"}).status, 0);
  struct stat status {};
  ASSERT_EQ(stat((folder_ / "lab.key").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600u);
  const auto before = read_file(folder_ / "lab.key");
  const auto again = run({"keys", "new", folder_ / "lab"});
  EXPECT_EQ(again.status, 1);
  EXPECT_THAT(again.err, AllOf(HasSubstr("lab.key"), HasSubstr("never overwritten")));
  EXPECT_EQ(read_file(folder_ / "lab.key"), before);
}

TEST_F(CliPlugin, SigningSaysWhatIsMissing) {
  const auto path = write("turtle.so", "abc");
  EXPECT_EQ(run({"sign", path}).status, 2);
  auto done = run({"sign", path, "--key", write("no.key", "nothing")});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, AllOf(HasSubstr("no.key"), HasSubstr("iotcloud keys new")));
  done = run({"sign", folder_ / "absent.so", "--key", folder_ / "no.key"});
  EXPECT_THAT(done.err, HasSubstr("absent.so"));
}

TEST_F(CliPlugin, AnUpdateSendsTheFileAndChangesTheInstances) {
  const std::string id =
      run_json({"deploy", "--plugin", write("turtle.so", "one"), "-g", "lab1"})["outcomes"][0]["instance"];
  const auto done = run({"update", "--settle", "0", "--plugin", write("turtle-2.so", "two"), id});
  EXPECT_EQ(done.status, 0) << done.out << done.err;
  EXPECT_EQ(lab1_.gateway.orders().at(0).sha256, security::sha256_hex("two"));
  EXPECT_EQ(lab2_.site->offers(), 0u) << "none of the instances is there";
  const auto described = run({"describe", id});
  EXPECT_THAT(described.out, AllOf(HasSubstr("turtle-2.so"), HasSubstr(security::sha256_hex("two").substr(0, 12)),
                                   HasSubstr("not signed")));
}

TEST_F(CliPlugin, AnUpdateThatFailsGoesBackAndEndsWithStatusOne) {
  ASSERT_EQ(run({"deploy", "--plugin", write("turtle.so", "one"), "--all"}).status, 0);
  lab2_.gateway.behave([](const discovery::OrderRecord& order) {
    return order.sha256 == security::sha256_hex("two")
               ? FakeGateway::Report{discovery::DriverState::failed, "built with another SDK"}
               : *FakeGateway::obey(order);
  });
  const auto done = run({"update", "--plugin", write("turtle-2.so", "two"), "--driver", "turtle"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, AllOf(HasSubstr("lab1"), HasSubstr("lab2"), HasSubstr("built with another SDK"),
                              HasSubstr("back on turtle.so")));
  EXPECT_EQ(lab1_.gateway.orders().at(0).sha256, security::sha256_hex("one"));
  EXPECT_EQ(lab2_.gateway.orders().at(0).sha256, security::sha256_hex("one"));
}

TEST_F(CliPlugin, AnUpdateChangesNothingWhenAGatewayDoesNotTakeTheFile) {
  ASSERT_EQ(run({"deploy", "--plugin", write("turtle.so", "one"), "--all"}).status, 0);
  lab2_.site->refuse_with("its disk is full");
  const auto done = run({"update", "--plugin", write("turtle-2.so", "two"), "--all"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("no instance was updated"));
  EXPECT_THAT(done.out, AllOf(HasSubstr("lab2"), HasSubstr("its disk is full")));
  EXPECT_EQ(lab1_.gateway.orders().at(0).sha256, security::sha256_hex("one"));
}

TEST_F(CliPlugin, WrongUsageIsSaid) {
  EXPECT_EQ(run({"deploy", "-g", "lab1"}).status, 2);
  EXPECT_EQ(run({"deploy", "a.so", "--plugin", "b.so", "-g", "lab1"}).status, 2);
  EXPECT_EQ(run({"update", "--plugin", "./x.so"}).status, 2) << "of which instances?";
  const auto id = deploy("lab1");
  EXPECT_EQ(run({"update", id}).status, 2);
  const auto done = run({"update", "--plugin", folder_ / "absent.so", id});
  EXPECT_EQ(done.status, 2);
  EXPECT_THAT(done.err, HasSubstr("absent.so"));
  EXPECT_EQ(run({"deploy", "--plugin", write("empty.so", ""), "-g", "lab1"}).status, 2);
  EXPECT_EQ(run({"deploy", "--plugin", folder_, "-g", "lab1"}).status, 2) << "a folder is no plugin";
}

/// Manifests with plugins of this machine.
class FleetOfFiles : public CliPlugin {
 protected:
  void manifest(const std::string& deployments) const {
    write("fleet.yaml", "fleet: lab\ndeployments:\n" + deployments);
  }
  Finished fleet(const std::string& verb) const { return run({verb, "-f", folder_ / "fleet.yaml"}); }
};

TEST_F(FleetOfFiles, ApplySendsAFileFromTheManifestsFolderAndASecondTimeNothing) {
  write("meter.so", "one");
  manifest("  meter: {plugin: ./meter.so, gateways: all, count: 2}\n");
  const auto first = fleet("apply");
  EXPECT_EQ(first.status, 0) << first.out << first.err;
  for (auto* lab : {&lab1_, &lab2_}) {
    EXPECT_EQ(lab->site->received(), "one");
    ASSERT_THAT(lab->gateway.orders(), SizeIs(2));
    EXPECT_EQ(lab->gateway.orders().at(0).plugin, "meter.so");
    EXPECT_EQ(lab->gateway.orders().at(0).sha256, security::sha256_hex("one"));
  }
  EXPECT_EQ(fleet("diff").status, 0);
  const auto offers = lab1_.site->offers();
  EXPECT_THAT(fleet("apply").out, HasSubstr("nothing to do: 4 instances"));
  EXPECT_EQ(lab1_.site->offers(), offers);
}

TEST_F(FleetOfFiles, OtherBytesAreAnotherPluginWhichDiffShowsAndSendsNowhere) {
  write("meter.so", "one");
  manifest("  meter: {plugin: ./meter.so, gateways: [lab1]}\n");
  ASSERT_EQ(fleet("apply").status, 0);
  const auto id = lab1_.gateway.orders().at(0).instance;
  write("meter.so", "two");
  const auto shown = fleet("diff");
  EXPECT_EQ(shown.status, 4);
  EXPECT_THAT(shown.out, HasSubstr("meter.so (" + security::short_sha256(security::sha256_hex("one")) +
                                   ") -> meter.so (" + security::short_sha256(security::sha256_hex("two")) + ")"));
  EXPECT_EQ(lab1_.site->offers(), 1u);
  const auto done = fleet("apply");
  EXPECT_EQ(done.status, 0) << done.out << done.err;
  EXPECT_EQ(lab1_.gateway.orders().at(0).sha256, security::sha256_hex("two"));
  EXPECT_EQ(lab1_.gateway.orders().at(0).instance, id);
  EXPECT_EQ(lab2_.site->offers(), 0u);
}

TEST_F(FleetOfFiles, AGatewayThatDoesNotTakeAFileKeepsWhatItRunsAndTheOthersChange) {
  write("meter.so", "one");
  manifest("  meter: {plugin: ./meter.so, gateways: all}\n");
  ASSERT_EQ(fleet("apply").status, 0);
  write("meter.so", "two");
  lab2_.site->refuse_with("meter.so is not signed");
  const auto done = fleet("apply");
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("lab2: 1 of 1 changes not done; the first: failed: "));
  EXPECT_THAT(done.err, HasSubstr("meter.so is not signed"));
  EXPECT_EQ(lab1_.gateway.orders().at(0).sha256, security::sha256_hex("two"));
  EXPECT_EQ(lab2_.gateway.orders().at(0).sha256, security::sha256_hex("one"));
}

TEST_F(FleetOfFiles, AFileThatIsNotThereIsAnErrorWithItsLine) {
  manifest("  meter: {plugin: ./absent.so, gateways: [lab1]}\n");
  const auto done = fleet("diff");
  EXPECT_EQ(done.status, 2);
  EXPECT_THAT(done.err, AllOf(HasSubstr("fleet.yaml:3:"), HasSubstr("absent.so cannot be read")));
}

TEST_F(CliPlugin, AGatewayThatDrainsIsPassedByWhenAFileGoesToAll) {
  ASSERT_EQ(run({"drain", "lab1"}).status, 0);
  const auto done = run({"deploy", "--plugin", write("turtle.so", "abc"), "--all"});
  EXPECT_EQ(done.status, 0) << done.out << done.err;
  EXPECT_EQ(lab1_.site->offers(), 0u);
  EXPECT_THAT(lab1_.gateway.orders(), SizeIs(0));
  EXPECT_THAT(lab2_.gateway.orders(), SizeIs(1));
  ASSERT_EQ(run({"drain", "lab2"}).status, 0);
  const auto none = run({"deploy", "--plugin", folder_ / "turtle.so", "--all"});
  EXPECT_EQ(none.status, 1);
  EXPECT_THAT(none.err, HasSubstr("all gateways are draining"));
}

constexpr const char* meter =
    R"({"driver":"meter","version":"1.2","sdk_version":7,"description":"A meter","properties":[)"
    R"({"name":"rate","type":"number","unit":"1/s","min":0.1,"max":1000,"default":"10","text":"readings"},)"
    R"({"name":"mode","type":"text","choices":["fast","slow"]},{"name":"base","type":"text"}]})";

class DeclaredProperties : public FleetOfFiles {
 protected:
  DeclaredProperties() {
    lab1_.site->have("meter.so", meter);
    lab2_.site->have("meter.so", meter);
  }
};

TEST_F(DeclaredProperties, AWrongOneIsRefusedBeforeAnythingIsOrdered) {
  const auto done = run({"deploy", "meter.so", "--all", "-n", "11", "-p", "rat=5", "-p", "mode=medium"});
  EXPECT_EQ(done.status, 2);
  EXPECT_THAT(done.err, AllOf(HasSubstr("property \"rat\": unknown property; did you mean \"rate\"? (meter.so)"),
                              HasSubstr("property \"mode\": \"medium\"; it takes one of fast, slow")));
  EXPECT_THAT(lab1_.gateway.orders(), SizeIs(0));
  manifest("  meter:\n    plugin: meter.so\n    gateways: all\n    count: 11\n    properties: {rat: 5}\n");
  for (const char* verb : {"diff", "apply"}) {
    const auto of_manifest = fleet(verb);
    EXPECT_EQ(of_manifest.status, 2) << verb;
    EXPECT_THAT(of_manifest.err, HasSubstr("fleet.yaml:7:18: deployments.meter.properties.rat: unknown property; did "
                                           "you mean \"rate\"? (meter.so)"));
  }
  EXPECT_THAT(lab1_.gateway.orders(), SizeIs(0));
  EXPECT_EQ(run({"deploy", "-g", "lab1", "lab2", "meter.so", "-p", "rate=5"}).status, 0) << "the last is no gateway";
}

TEST_F(DeclaredProperties, AFileOfThisMachineIsCheckedBeforeItIsSent) {
  const auto done = run({"deploy", LOADGEN_PLUGIN, "--all", "-p", "rat=5"});
  EXPECT_EQ(done.status, 2);
  EXPECT_THAT(done.err, HasSubstr("did you mean \"rate\"?"));
  EXPECT_EQ(lab1_.site->offers(), 0U);
}

TEST_F(DeclaredProperties, APluginThatDeclaresNothingAndAnUnknownOneAreAcceptedAsBefore) {
  const auto done = run({"deploy", "turtle.so", "-g", "lab1", "-p", "any=thing"});
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_EQ(done.err, "");
}

TEST_F(DeclaredProperties, TheNumberOfAnInstanceStandsForItsMark) {
  const auto done = run({"deploy", "meter.so", "-g", "lab1", "lab2", "--name", "m", "-n", "2", "-p", "base=r{index}"});
  EXPECT_EQ(done.status, 0) << done.err;
  for (auto* lab : {&lab1_, &lab2_}) {
    std::map<int, std::string> bases;
    for (const auto& order : lab->gateway.orders()) bases[order.index] = order.properties.at("base");
    EXPECT_EQ(bases, (std::map<int, std::string>{{1, "r1"}, {2, "r2"}}));
  }
  const auto again = run({"deploy", "meter.so", "-g", "lab1", "--name", "m", "-n", "2", "-p", "base=r{index}"});
  EXPECT_EQ(again.status, 0) << again.err;
  EXPECT_THAT(again.out, HasSubstr("unchanged"));
}

TEST_F(DeclaredProperties, AManifestMayGiveEachInstanceItsOwn) {
  write("each.csv", "base,rate\nroof,5\ncellar,\n");
  manifest("  m: {plugin: meter.so, gateways: [lab1], each: each.csv}\n");
  ASSERT_EQ(fleet("apply").status, 0);
  std::map<int, std::map<std::string, std::string>> properties;
  for (const auto& order : lab1_.gateway.orders()) properties[order.index] = order.properties;
  EXPECT_EQ(properties[1], (std::map<std::string, std::string>{{"base", "roof"}, {"rate", "5"}}));
  EXPECT_EQ(properties[2], (std::map<std::string, std::string>{{"base", "cellar"}}));
  EXPECT_EQ(fleet("diff").status, 0);
  write("each.csv", "base,rate\nroof,5\ncellar,7\n");
  EXPECT_THAT(fleet("diff").out, HasSubstr("rate: - -> 7"));
  ASSERT_EQ(fleet("apply").status, 0);
  EXPECT_EQ(fleet("diff").status, 0);
}

TEST_F(DeclaredProperties, AChangeGoesStepByStepAndBackWhenAnInstanceDoesNotComeUp) {
  manifest("  m: {plugin: meter.so, gateways: all, properties: {base: roof}}\n");
  ASSERT_EQ(fleet("apply").status, 0);
  lab2_.gateway.behave([](const discovery::OrderRecord& order) {
    return order.properties.at("base") == "cellar" ? FakeGateway::Report{discovery::DriverState::failed, "too damp"}
                                                   : *FakeGateway::obey(order);
  });
  manifest("  m: {plugin: meter.so, gateways: all, properties: {base: cellar}, metadata: {site: lab}}\n");
  const auto done = run({"apply", "-f", folder_ / "fleet.yaml", "--settle", "0"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, AllOf(HasSubstr("back on its former properties"), HasSubstr("too damp"),
                              HasSubstr("not begun, for its deployment was not updated")));
  for (auto* lab : {&lab1_, &lab2_}) EXPECT_EQ(lab->gateway.orders().at(0).properties.at("base"), "roof");
}

TEST_F(DeclaredProperties, UpdateChangesSomeAndKeepsTheOthers) {
  ASSERT_EQ(run({"deploy", "meter.so", "--all", "--name", "m", "-p", "base=roof", "-p", "rate=5"}).status, 0);
  const auto wrong = run({"update", "--name", "m", "-p", "rate=0"});
  EXPECT_EQ(wrong.status, 2);
  EXPECT_THAT(wrong.err, HasSubstr("it takes a number from 0.1 to 1000 (1/s)"));
  const auto done = run({"update", "--name", "m", "-p", "rate=7", "--settle", "0"});
  EXPECT_EQ(done.status, 0) << done.out << done.err;
  for (auto* lab : {&lab1_, &lab2_}) {
    EXPECT_EQ(lab->gateway.orders().at(0).properties,
              (std::map<std::string, std::string>{{"base", "roof"}, {"rate", "7"}}));
    EXPECT_EQ(lab->gateway.orders().at(0).plugin, "meter.so");
  }
  const auto again = run({"update", "--name", "m", "-p", "rate=7", "--settle", "0"});
  EXPECT_EQ(again.status, 0);
  EXPECT_THAT(again.out, HasSubstr("it has this version and properties already"));
}

TEST_F(DeclaredProperties, ListAndDescribeShowWhatGatewaysHave) {
  const auto list = run({"plugin", "list"});
  EXPECT_EQ(list.status, 0) << list.err;
  EXPECT_THAT(list.out, AllOf(HasSubstr("meter.so"), HasSubstr("1.2"), HasSubstr("lab key, version 3"),
                              HasSubstr("folder"), HasSubstr("lab1, lab2")));
  const auto described = run({"plugin", "describe", "meter.so"});
  EXPECT_EQ(described.status, 0) << described.err;
  EXPECT_THAT(described.out, AllOf(HasSubstr("A meter"), HasSubstr("rate"), HasSubstr("a number from 0.1 to 1000"),
                                   HasSubstr("one of fast, slow"), HasSubstr("readings")));
  EXPECT_EQ(run_json({"plugin", "describe", "meter.so"})[0]["properties"][1]["choices"][0], "fast");
  EXPECT_EQ(run({"plugin", "describe", "absent.so"}).status, 1);
  const auto file = run({"plugin", "describe", LOADGEN_PLUGIN});
  EXPECT_EQ(file.status, 0) << file.err;
  EXPECT_THAT(file.out, AllOf(HasSubstr("loadgen"), HasSubstr("a whole number from 32 to")));
}

TEST_F(DeclaredProperties, AreCompleted) {
  // A shell waits for the master's answer for a second only: again until a busy one has answered.
  const auto is_completed = [&](const Words& words, const std::string& wanted) {
    std::string found;
    return eventually([&] { return !(found = run(words).out).empty(); }) && found == wanted;
  };
  EXPECT_TRUE(is_completed({"__complete", "deploy", "meter.so", "--property", "r"}, "rate=\n"));
  EXPECT_TRUE(
      is_completed({"__complete", "deploy", "--plugin", LOADGEN_PLUGIN, "-p", "sh"}, "shared=false\nshared=true\n"));
  EXPECT_TRUE(is_completed({"__complete", "update", "--plugin", "meter.so", "-p", "mode=f"}, "mode=fast\n"));
}

}  // namespace
}  // namespace iotcloud::master::test
