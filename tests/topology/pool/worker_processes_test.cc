// Workers as processes that are really started, adopted and killed; pooled_program.cc plays the worker.
#include <filesystem>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/processes/landlock.h>
#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/topology/pool/worker_fixture.h>

namespace iotcloud::topology {
namespace {

using namespace std::chrono_literals;
using How = WorkerEnding::How;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;
using tests::eventually;

TEST_F(WorkerProcessesTest, RunsAWorkerAndEndsIt) {
  const auto workers = make();
  const auto link = workers->start(order("run"), told_.events());
  ASSERT_TRUE(told_.runs());
  EXPECT_THAT(kept(), SizeIs(2)) << "its folder, and the order to it";
  link->stop(tests::patience);
  EXPECT_EQ(told_.ending().how, How::stopped);
  EXPECT_THAT(told_.ending().reason, IsEmpty());
  EXPECT_THAT(kept(), IsEmpty());
  EXPECT_TRUE(std::filesystem::exists(WorkerProcesses::log_of(state_, order("run").place)));
}

TEST_F(WorkerProcessesTest, AWorkerThatWorksDoesNotRunBeforeTheRegistryHasItsRecord) {
  program_ = WORKER_PROGRAM;
  const auto workers = make();
  // A registry that does not answer.
  const auto link = workers->start(order(R"(topology.name: t
zk.servers: ["127.0.0.1:1"]
spouts:
  receive: {broker: rabbitmq, driver: d, channel: up, fields: [data, driverID, time]}
bolts:
  send: {broker: rabbitmq, driver: d, channel: down, fields: [data, driverID, time], inputs: [{from: receive}]}
)"),
                                   told_.events());
  const std::string log = WorkerProcesses::log_of(state_, order("").place);
  ASSERT_TRUE(eventually([&] {
    return tests::read_file(log).find("the registry does not answer; topology t runs as its YAML says") !=
           std::string::npos;
  })) << tests::read_file(log);
  const int before = told_.reports();
  ASSERT_TRUE(eventually([&] { return told_.reports() > before + 1; })) << "an answer that was asked for since";
  EXPECT_FALSE(told_.report().runs);
  link->stop(0ms);  // by force, rather than to wait until the worker gives up the registry
  EXPECT_EQ(told_.ending().how, How::stopped);
}

TEST_F(WorkerProcessesTest, TellsWhyAWorkerCannotRun) {
  const auto workers = make();
  const auto link = workers->start(order("refuse"), told_.events());
  EXPECT_EQ(told_.ending().how, How::refused);
  EXPECT_EQ(told_.ending().reason, "there is no class");
}

TEST_F(WorkerProcessesTest, TellsWhyAWorkerFailed) {
  const auto workers = make();
  const auto link = workers->start(order("fail"), told_.events());
  EXPECT_EQ(told_.ending().how, How::failed);
  EXPECT_EQ(told_.ending().reason, "there is no class");
}

TEST_F(WorkerProcessesTest, TellsHowAWorkerCrashed) {
  const auto workers = make();
  const auto link = workers->start(order("crash"), told_.events());
  EXPECT_EQ(told_.ending().how, How::failed);
  EXPECT_THAT(told_.ending().reason, HasSubstr("signal 6"));
}

TEST_F(WorkerProcessesTest, AConfinedWorkerReachesItsOwnFolderAndNoFileOfThePool) {
  std::ofstream(state_ + "/secret") << "the pool's";
  const auto look_around = [&] {
    Told told;
    const auto workers = make();
    const auto link = workers->start(order("look around"), told.events());
    return told.ending().reason;
  };
  EXPECT_EQ(look_around(), "secret folder socket ptrace ");
  confinement_.no_new_privileges = true;
  confinement_.filter_calls = true;
  if (processes::landlock_version() > 0) confinement_.files.emplace();
  EXPECT_EQ(look_around(),
            std::string(processes::landlock_version() > 0 ? "" : "secret ") + "folder socket no-new-privileges ");
}

TEST_F(WorkerProcessesTest, KillsAWorkerThatHangs) {
  hang_limit_ = 10s;  // in which a busy machine starts it; 500 pings, more than a socket holds
  const auto workers = make();
  const auto link = workers->start(order("stand still"), told_.events());
  EXPECT_EQ(told_.ending().how, How::failed);
  EXPECT_TRUE(told_.report().runs) << "it must have hung, not started slowly";
  EXPECT_THAT(told_.ending().reason, HasSubstr("hung: no answer for 10000 ms"));
}

TEST_F(WorkerProcessesTest, KillsAWorkerInWhichACallDoesNotReturn) {
  call_limit_ = 299ms;
  const auto workers = make();
  const auto link = workers->start(order("long call 300"), told_.events());
  EXPECT_EQ(told_.ending().how, How::failed);
  EXPECT_EQ(told_.ending().reason, "hung: count/2 did not return from a call for 300 ms");
}

TEST_F(WorkerProcessesTest, LeavesAWorkerAloneWhoseCallsTakeAsLongAsTheyMay) {
  call_limit_ = 300ms;
  const auto workers = make();
  const auto link = workers->start(order("long call 300"), told_.events());
  ASSERT_TRUE(eventually([&] { return told_.answers() > 3; }));
  link->stop(tests::patience);
  EXPECT_EQ(told_.ending().how, How::stopped);
}

TEST_F(WorkerProcessesTest, KillsAWorkerThatDoesNotStop) {
  const auto workers = make();
  const auto link = workers->start(order("stay"), told_.events());
  ASSERT_TRUE(told_.runs());
  link->stop(0ms);
  EXPECT_EQ(told_.ending().how, How::stopped);
  EXPECT_THAT(told_.ending().reason, HasSubstr("was killed"));
}

TEST_F(WorkerProcessesTest, AWorkerThatWritesWhatIsNoFrameIsEndedAndLeavesNothing) {
  const auto workers = make();
  const auto link = workers->start(order("babble"), told_.events());
  EXPECT_EQ(told_.ending().how, How::failed);
  EXPECT_THAT(told_.ending().reason, HasSubstr("was ended: "));
  EXPECT_THAT(kept(), IsEmpty());
}

TEST_F(WorkerProcessesTest, WritesToNoLogThatAWorkerHasReplacedByALink) {
  const auto workers = make();
  const std::string log = WorkerProcesses::log_of(state_, order("run").place), other = state_ + "/other";
  std::filesystem::create_directories(std::filesystem::path(log).parent_path());
  std::filesystem::create_symlink(other, log);
  try {
    workers->start(order("run"), told_.events());
    FAIL() << "it was started";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr(log));
  }
  EXPECT_FALSE(std::filesystem::exists(other));
  EXPECT_THAT(kept(), IsEmpty());
}

TEST_F(WorkerProcessesTest, TheNextRunFindsAWorkerThatOutlivedThePool) {
  int process = 0;
  {
    Told before;
    const auto workers = make();
    const auto link = workers->start(order("run"), before.events());
    ASSERT_TRUE(before.runs());
    process = before.process();
  }
  std::filesystem::create_directories(state_ + "/workers/of one that has ended");
  const auto workers = make();
  const auto left = workers->running();
  ASSERT_THAT(left, SizeIs(1));
  EXPECT_EQ(left[0].place, order("run").place);
  EXPECT_EQ(left[0].version, 1);
  EXPECT_THAT(kept(), SizeIs(2)) << "of the worker that lives";
  const auto link = workers->adopt(left[0], told_.events());
  ASSERT_TRUE(told_.runs());
  EXPECT_EQ(told_.process(), process);
  link->stop(tests::patience);
  EXPECT_EQ(told_.ending().how, How::stopped);
}

TEST_F(WorkerProcessesTest, StartsNoWorkerWithoutItsLibraryOrWithOtherBytesThanWereSent) {
  const auto workers = make();
  auto wanted = order("run");
  const std::string bytes = "a library";
  wanted.version.libraries = {{"x.so", "x.so", security::sha256_hex(bytes)}};
  try {
    workers->start(wanted, told_.events());
    FAIL() << "it was started";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("the component library x.so"));
  }
  const auto upload = store_->offer({"x.so", security::sha256_hex(bytes), static_cast<std::int64_t>(bytes.size()), ""});
  store_->add(upload, 0, bytes);
  store_->finish(upload);
  const auto link = workers->start(wanted, told_.events());
  EXPECT_TRUE(told_.runs());
  link->stop(tests::patience);
  EXPECT_EQ(told_.ending().how, How::stopped);
  const std::string path = *store_->path_of(security::sha256_hex(bytes));
  std::filesystem::permissions(path, std::filesystem::perms::owner_all);
  std::ofstream(path) << "others";
  EXPECT_THROW(workers->start(wanted, told_.events()), config::Error);
  EXPECT_THAT(kept(), IsEmpty());
}

TEST_F(WorkerProcessesTest, AnOlderSignedLibraryThanOneThatRanRunsOnlyForATopologyThatGoesBackToIt) {
  const auto lab = security::new_key_pair();
  security::TrustedKeys::Options signers;
  signers.require_signature = true;
  signers.trusted_keys = {tests::write_file(folder_ + "/lab.pub", lab.public_pem)};
  trust_ = std::make_shared<const security::TrustedKeys>(signers);
  const auto send = [&](const std::string& bytes, const std::string& signature) {
    const auto sha256 = security::sha256_hex(bytes);
    const auto upload = store_->offer({"x.so", sha256, static_cast<std::int64_t>(bytes.size()), signature});
    store_->add(upload, 0, bytes);
    store_->finish(upload);
    auto wanted = order("run");
    wanted.version.libraries = {{"x.so", "x.so", sha256}};
    return wanted;
  };
  const auto signed_as = [&](std::uint64_t version) {
    const auto bytes = "the library " + std::to_string(version);
    return send(bytes, security::sign_plugin(lab.private_pem, "lab", bytes, "x", version));
  };
  auto older = signed_as(1);
  const auto newer = signed_as(2), bare = send("a library", security::sign(lab.private_pem, "lab", "a library"));
  const auto refusal_by = [](WorkerProcesses& workers, const WorkerOrder& wanted) -> std::string {
    Told told;
    try {
      const auto link = workers.start(wanted, told.events());
      EXPECT_TRUE(told.runs());
      link->stop(tests::patience);
      EXPECT_EQ(told.ending().how, How::stopped);
    } catch (const WorkerRefused& refused) {
      return refused.what();
    }
    return "";
  };
  const auto unconcerned = make();
  for (const auto& wanted : {newer, older, bare})
    EXPECT_THAT(refusal_by(*unconcerned, wanted), IsEmpty()) << "the attack";

  require_version_ = true;
  {
    const auto workers = make();
    EXPECT_THAT(refusal_by(*workers, older), IsEmpty());
    EXPECT_THAT(refusal_by(*workers, newer), IsEmpty());
    EXPECT_THAT(refusal_by(*workers, bare), HasSubstr("was signed without a version"));
  }
  const auto workers = make();
  EXPECT_THAT(refusal_by(*workers, older), AllOf(HasSubstr("version 1 of x is older than version 2, which ran here"),
                                                 HasSubstr("libraries.allow_rollback")));
  older.goes_back = true;
  EXPECT_THAT(refusal_by(*workers, older), IsEmpty());
}

}  // namespace
}  // namespace iotcloud::topology
