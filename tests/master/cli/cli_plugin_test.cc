// deploy and update with a plugin of this machine, keys and signatures: what the command line sends, by way of the
// master, to gateways' Thrift services.
#include <filesystem>

#include <gmock/gmock.h>
#include <sys/stat.h>

#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/master/cli/cli_fixture.h>
#include <iotcloud/tests/master/cli/receiving_gateway.h>

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
  serve_at(url, "far", free_port());
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

}  // namespace
}  // namespace iotcloud::master::test
