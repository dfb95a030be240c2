#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/topology/state/stateful_bolt.h>
#include <iotcloud/topology/worker/check.h>

namespace iotcloud::topology {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

/// `iotcloud-topology --check`, and the same as a function.
class Check : public testing::Test {
 protected:
  Check() { fs::create_directory(folder_); }
  ~Check() override { fs::remove_all(folder_); }

  std::string write(const std::string& text) const {
    std::string file = folder_ / "t.yaml";
    std::ofstream(file) << text;
    return file;
  }
  /// \return the exit status, and what it printed (to stdout and stderr).
  static std::pair<int, std::string> run(const std::string& arguments) {
    FILE* pipe = popen(("exec " WORKER_PROGRAM " " + arguments + " 2>&1").c_str(), "r");
    if (pipe == nullptr) return {-1, "popen failed"};
    std::string text;
    char buffer[4096];
    while (const std::size_t size = std::fread(buffer, 1, sizeof buffer, pipe)) text.append(buffer, size);
    return {WEXITSTATUS(pclose(pipe)), text};
  }
  const fs::path folder_ = fs::temp_directory_path() / ("iotcloud-check-" + std::to_string(getpid()));
};

/// Counts nothing.
struct Counts : StatefulBolt {
  void prepare(const Config&, const TopologyContext&, OutputCollector&) override {}
  void init_state(KeyValueState&) override {}
  void execute(const Tuple&) override {}
};

/// Its registry and broker are where nobody listens.
const std::string good = R"(topology.name: t
zk.servers: ["127.0.0.1:1"]
topology.library: ")" GOOD_LIBRARY R"("
brokers: {rabbitmq: "amqp://127.0.0.1:1"}
spouts:
  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID]}
bolts:
  echo: {class: good.Echo, parallelism: 2, tasks: 4, inputs: {from: in, grouping: fields, fields: [driverID]}}
)";

TEST_F(Check, PrintsTheGraphAndContactsNobody) {
  const auto [status, text] = run("--check " + write(good));
  EXPECT_EQ(status, 0);
  EXPECT_EQ(text, R"(topology t: 2 components
registry zookeeper://127.0.0.1:1, drivers below /iot/sensors

spout in: 1 executor, 1 task; reads channel "up" of driver "d", broker "rabbitmq"
  -> text, driverID

bolt echo: 2 executors, 4 tasks; class good.Echo
  <- in, fields (driverID)
)");
}

TEST_F(Check, SaysWhatASubmissionTakesAndWhyItCannotBeOne) {
  const auto submission = [&](const std::string& text) { return run("--check-submission " + write(text)).second; };
  EXPECT_EQ(submission(good),
            "\n{\"topology\":\"t\",\"libraries\":[{\"name\":\"" GOOD_LIBRARY "\",\"path\":\"" GOOD_LIBRARY
            "\"}],\"crossings\":\"\",\"registry\":\"zookeeper://127.0.0.1:1\"}\n");
  std::string across = good;
  across.replace(across.find("grouping: fields, fields: [driverID]"), 36, "grouping: global");
  EXPECT_THAT(submission(across), HasSubstr("echo <- in, global"));
  std::string wrong = good;
  wrong.replace(wrong.find("good.Echo"), 9, "good.Ecco");
  EXPECT_THAT(submission(wrong), AllOf(StartsWith("\n{\"error\":"), HasSubstr("did you mean")));
  std::string nowhere = good;
  nowhere.replace(nowhere.find("zk.servers"), 10, "# zk.serve");
  EXPECT_THAT(submission(nowhere), HasSubstr("zk.servers"));
}

TEST_F(Check, SaysWhatIsWrongAndWhereAndEndsWithTwo) {
  std::string wrong = good;
  wrong.replace(wrong.find("good.Echo"), 9, "good.Ecco");
  const std::string file = write(wrong);
  const auto [status, text] = run("--check " + file);
  EXPECT_EQ(status, 2);
  EXPECT_THAT(text, AllOf(StartsWith("iotcloud-topology: " + file + ":8:10: bolts.echo.class: "),
                          HasSubstr("did you mean \"good.Echo\"?")));
}

TEST_F(Check, SaysAllErrorsOfTheFileAtOnceWithTheirPlaces) {
  const std::string file = write(R"(topology.name: t
topology.library: "turtlebot_follower.so"
runtime: {message_timeout: 30}
spouts:
  in: {broker: rabbitmq, driver: d, channel: up, fields: [frame, driverID], prefech: 5, parallelism: none}
bolts:
  decode: {class: turtlebot.Decodr, inputs: {from: inn}}
  second: {class: turtlebot.Decoder, conf: {codec: png}, inputs: {from: in}}
  follow:
    class: turtlebot.Follow
    conf: {goal_distanze: 1, max_linear: fast}
    inputs: {from: decode, grouping: fileds, fields: [driverID]}
)");
  const auto [status, text] = run("--check " + file);
  EXPECT_EQ(status, 2);
  std::vector<std::string> lines;
  std::istringstream printed(text);
  for (std::string line; std::getline(printed, line);) lines.push_back(line);
  const auto at = [&](const std::string& place) { return HasSubstr(file + place); };
  EXPECT_THAT(lines,
              ElementsAre(AllOf(at(":3:11: runtime.message_timeout:"), HasSubstr("a number and a unit")),
                          AllOf(at(":5:77: spouts.in.prefech: unknown key"), HasSubstr("known are")),
                          AllOf(at(":5:89: spouts.in.parallelism: \"none\""), HasSubstr("whole number")),
                          AllOf(at(":7:12: bolts.decode.class:"), HasSubstr("did you mean \"turtlebot.Decoder\"?")),
                          AllOf(at(":7:46: bolts.decode.inputs.from:"), HasSubstr("did you mean \"in\"?")),
                          AllOf(at(":8:45: bolts.second.conf.codec: unknown key"), HasSubstr("there are none")),
                          AllOf(at(":11:12: bolts.follow.conf.goal_distanze:"), HasSubstr("\"goal_distance\"?")),
                          AllOf(at(":11:30: bolts.follow.conf.max_linear:"), HasSubstr("a number from 0 to 10")),
                          AllOf(at(":12:28: bolts.follow.inputs.grouping:"), HasSubstr("\"fields\"?"))))
      << text;
}

TEST_F(Check, SaysWhichKeyOfAStateIsMisspeltAndWhatItMayBe) {
  const std::string file = write(R"(topology.name: t
spouts:
  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID]}
bolts:
  count:
    class: Counts
    conf: {state.store: "memory://t", state.checkpiont: 500ms}
    inputs: {from: in}
)");
  ComponentRegistry components;
  components.add_bolt("Counts", make_stateful_bolt<Counts>());
  try {
    check_topology(file, {}, components);
    FAIL() << "it passes";
  } catch (const config::ConfigError& error) {
    EXPECT_EQ(error.what(), file +
                                ":7:39: bolts.count.conf.state.checkpiont: unknown key; did you mean "
                                "\"state.checkpoint\"?");
  }
}

TEST_F(Check, SaysThatALibraryIsMissing) {
  std::string wrong = good;
  wrong.replace(wrong.find(GOOD_LIBRARY), std::string(GOOD_LIBRARY).size(), "nowhere.so");
  const auto [status, text] = run("--check " + write(wrong));
  EXPECT_EQ(status, 2);
  EXPECT_THAT(text, AllOf(HasSubstr("t.yaml:3:1: topology.library"), HasSubstr("nowhere.so")));
}

TEST_F(Check, TakesAFileForLocalModeThatNamesNoRegistry) {
  std::string local = good;
  local.erase(local.find("zk.servers"), local.find("topology.library") - local.find("zk.servers"));
  EXPECT_THAT(check_topology(write(local), {}), HasSubstr("local mode only"));
}

TEST_F(Check, FindsALibraryBesideTheFileAndThenInTheFolders) {
  const fs::path library = GOOD_LIBRARY;
  std::string text = good;
  text.replace(text.find(GOOD_LIBRARY), std::string(GOOD_LIBRARY).size(), library.filename());
  const std::string file = write(text);
  EXPECT_THROW(check_topology(file, {}), config::ConfigError);
  EXPECT_THAT(check_topology(file, {library.parent_path()}), HasSubstr("good.Echo"));
  fs::copy_file(library, folder_ / library.filename());
  EXPECT_THAT(check_topology(file, {}), HasSubstr("good.Echo"));
}

TEST_F(Check, IsInTheHelp) {
  EXPECT_THAT(run("--help").second, HasSubstr("--check FILE"));
}

TEST_F(Check, WhatIsSubmittedMayNameFilesOfTheMachinesOnWhichItWillRun) {
  std::string text = good;
  const std::string broker = R"("amqp://127.0.0.1:1")";
  text.replace(text.find(broker), broker.size(),
               "{urls: [\"amqps://127.0.0.1:1/\"], user: workers, password_file: /nowhere/rabbitmq.password}");
  const std::string file = write(text + R"(
registry.user: workers
registry.password_file: /nowhere/registry.password
registry.users: /nowhere/registry.users
orders.trusted_keys: [/nowhere/orders.pub]
metrics:
  address: "0.0.0.0:0"
  tls: {ca: /nowhere/ca.pem, certificate: /nowhere/host.pem, key: /nowhere/host.key}
  tokens: /nowhere/tokens
  certificates: [/nowhere/tunnel.pem]
)");
  const auto [status, said] = run("--check " + file);
  EXPECT_EQ(status, 2) << "it does not run here";
  for (const char* name :
       {"registry.password", "registry.users", "rabbitmq.password", "ca.pem", "tokens", "tunnel.pem"})
    EXPECT_THAT(said, HasSubstr("/nowhere/" + std::string(name)));
  EXPECT_THAT(run("--check-submission " + file).second, AllOf(HasSubstr(R"("topology":"t")"), Not(HasSubstr("error"))));
}

}  // namespace
}  // namespace iotcloud::topology
