#include <cstdio>
#include <fstream>
#include <future>
#include <map>
#include <optional>
#include <sstream>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/freeze.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/cli/program.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/cli/cli_fixture.h>
#include <iotcloud/tests/master/fleet.h>
#include <iotcloud/tests/master/process.h>

namespace iotcloud::master {
namespace {

using nlohmann::json;
using test::Cli;
using test::FakeGateway;
using test::TestMaster;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::SizeIs;
using testing::StartsWith;

TEST_F(Cli, DeploysAndListsAsJson) {
  FakeGateway gateway(url, "lab1");
  const auto answer = run_json({"deploy",
                                "turtle.so",
                                "--gateway",
                                "lab1",
                                "--driver",
                                "robot",
                                "--name",
                                "rover",
                                "--property=map=a=b",
                                "-c",
                                "kinect.deadline_ms=100",
                                "-p",
                                "speed=1",
                                "-m",
                                "room=12",
                                "--count",
                                "2",
                                "--on-partition",
                                "stop",
                                "--lease",
                                "30s"});
  EXPECT_EQ(answer["ok"], true);
  ASSERT_THAT(answer["outcomes"], SizeIs(2));
  EXPECT_EQ(answer["outcomes"][0]["outcome"], "done");
  EXPECT_EQ(gateway.orders().at(0).properties.at("map"), "a=b");
  EXPECT_EQ(gateway.orders().at(0).properties.at("speed"), "1");

  EXPECT_EQ(gateway.orders().at(0).properties.at("channel.kinect.deadline_ms"), "100");
  EXPECT_EQ(gateway.orders().at(0).properties.at("on_partition"), "stop");
  EXPECT_EQ(gateway.orders().at(0).properties.at("lease"), "30s");

  const auto drivers = run_json({"drivers"});
  ASSERT_THAT(drivers, SizeIs(2));
  EXPECT_EQ(drivers[0]["driver"], "robot");
  EXPECT_EQ(drivers[0]["name"], "rover");
  EXPECT_EQ(drivers[0]["gateway"], "lab1");
  EXPECT_EQ(drivers[0]["state"], "active");
  EXPECT_EQ(drivers[0]["metadata"]["room"], "12");
  EXPECT_EQ(drivers[0]["channels"][0]["name"], "kinect");
  EXPECT_EQ(drivers[0]["since_ms"], 1000);

  const auto gateways = run_json({"gateways"});
  ASSERT_THAT(gateways, SizeIs(1));
  EXPECT_EQ(gateways[0]["gateway"], "lab1");
  EXPECT_EQ(gateways[0]["state"], "ready");
}

TEST_F(Cli, TablesAreAligned) {
  FakeGateway one(url, "lab1");
  FakeGateway two(url, "a-much-longer-name");
  const auto done = run({"gateways"});
  EXPECT_EQ(done.status, 0) << done.err;
  std::istringstream lines(done.out);
  std::string head, first, second;
  std::getline(lines, head);
  std::getline(lines, first);
  std::getline(lines, second);
  EXPECT_EQ(head.find("STATE"), first.find("ready"));
  EXPECT_EQ(head.find("STATE"), second.find("ready"));
  EXPECT_EQ(head.find("ADDRESS"), second.find("127.0.0.1:12905"));
}

TEST_F(Cli, AFailedDeploymentHasTheReasonAndExitStatusOne) {
  FakeGateway gateway(url, "lab1", FakeGateway::fail("no such plugin; the folder has turtle.so"));
  const auto done = run({"deploy", "turtel.so", "--all"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, AllOf(HasSubstr("failed"), HasSubstr("no such plugin; the folder has turtle.so")));
  const auto listed = run({"drivers", "--state", "failed"});
  EXPECT_THAT(listed.out, HasSubstr("no such plugin"));
}

TEST_F(Cli, APartialDeploymentHasExitStatusOne) {
  FakeGateway good(url, "lab1");
  FakeGateway bad(url, "lab2", FakeGateway::fail("no"));
  const auto done = run({"deploy", "turtle.so", "-g", "lab1,lab2", "-o", "json"});
  EXPECT_EQ(done.status, 1);
  const auto answer = json::parse(done.out);
  EXPECT_EQ(answer["ok"], false);
  EXPECT_EQ(answer["outcomes"][0]["outcome"], "done");
  EXPECT_EQ(answer["outcomes"][1]["outcome"], "failed");
}

TEST_F(Cli, SeveralGatewaysMayFollowOneOption) {
  FakeGateway first(url, "lab1"), second(url, "lab2"), third(url, "lab3");
  ASSERT_EQ(run({"deploy", "turtle.so", "--all"}).status, 0);
  EXPECT_THAT(run_json({"drivers", "-g", "lab1", "lab2"}), testing::SizeIs(2));
  const auto refused = run({"undeploy", "--all", "-g", "lab1", "lap2"});
  EXPECT_NE(refused.status, 0);
  EXPECT_THAT(refused.err, HasSubstr("\"lap2\" is no gateway"));
  EXPECT_THAT(run({"undeploy", "-g", "lab1", "lab2"}).err, HasSubstr("takes --all"));
  EXPECT_THAT(run_json({"drivers"}), testing::SizeIs(3));
  EXPECT_EQ(run({"undeploy", "--all", "-g", "lab1", "lab3"}).status, 0);
  EXPECT_TRUE(tests::eventually([&] { return run_json({"drivers"}).size() == 1; }));
}

TEST_F(Cli, ASilentGatewayIsUnknownAfterTheWait) {
  FakeGateway silent(url, "lab1", FakeGateway::say_nothing());
  const auto done = run({"deploy", "turtle.so", "--all", "--wait", "0.05"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, HasSubstr("unknown"));
}

TEST_F(Cli, AnUnknownGatewayIsAnErrorThatListsTheKnownOnes) {
  FakeGateway gateway(url, "lab1");
  const auto done = run({"deploy", "turtle.so", "--gateway", "lab7"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, AllOf(StartsWith("iotcloud: "), HasSubstr("lab7"), HasSubstr("known gateways: lab1")));
}

TEST_F(Cli, IdsMayBeGivenByTheirBeginning) {
  FakeGateway gateway(url, "lab1");
  const auto id = deploy("lab1");
  EXPECT_EQ(run({"stop", id.substr(0, 8)}).status, 0);
  EXPECT_EQ(run_json({"drivers", id.substr(0, 8)})[0]["state"], "inactive");
  EXPECT_EQ(run({"start", id.substr(0, 8)}).status, 0);
  EXPECT_EQ(run({"undeploy", id.substr(0, 8)}).status, 0);
  EXPECT_THAT(run_json({"drivers"}), SizeIs(0));
  const auto gone = run({"undeploy", id});
  EXPECT_EQ(gone.status, 1);
  EXPECT_THAT(gone.err, HasSubstr("iotcloud drivers"));
}

TEST_F(Cli, RestartStopsAndStartsWhatIsChosen) {
  FakeGateway gateway(url, "lab1");
  const auto id = deploy("lab1");
  deploy("lab1");
  const int before = gateway.orders_seen();
  EXPECT_EQ(run({"restart", id}).status, 0);
  EXPECT_EQ(run_json({"drivers", id})[0]["state"], "active");
  EXPECT_EQ(gateway.orders_seen(), before + 2) << "this one's: stop, and start";
  EXPECT_EQ(run({"restart", "nobody"}).status, 1);
}

TEST_F(Cli, RestartLeavesAnInstanceAloneThatDoesNotStop) {
  FakeGateway gateway(url, "lab1");
  const auto id = deploy("lab1");
  const int before = gateway.orders_seen();
  gateway.behave(FakeGateway::fail("the device does not answer"));
  const auto done = run({"restart", id});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out + done.err, HasSubstr("the device does not answer"));
  EXPECT_EQ(gateway.orders_seen(), before + 1);
}

TEST_F(Cli, ABeginningOfSeveralIdsIsRefusedWithTheCandidates) {
  FakeGateway gateway(url, "lab1");
  // Seventeen ids: two begin with the same hexadecimal digit.
  std::map<char, std::string> by_digit;
  std::string digit, one, other;
  while (digit.empty()) {
    const auto id = deploy("lab1");
    const auto [at, is_new] = by_digit.emplace(id[0], id);
    if (is_new) continue;
    digit = id.substr(0, 1);
    one = at->second;
    other = id;
  }
  const auto done = run({"undeploy", digit});
  EXPECT_EQ(done.status, 2);
  EXPECT_THAT(done.err, AllOf(HasSubstr(one), HasSubstr(other), HasSubstr("give more of it")));
  EXPECT_THAT(run_json({"drivers", one}), SizeIs(1));
}

TEST_F(Cli, StatusShowsLeaderGatewaysDriversAndTopologies) {
  FakeGateway gateway(url, "lab1");
  { FakeGateway gone(url, "lab2"); }
  deploy("lab1");
  ASSERT_TRUE(test::eventually([&] { return !(*master)->gateways().at(1).alive; }));
  const auto status = run_json({"status"});
  EXPECT_EQ(status["master"]["leading"], true);
  EXPECT_EQ(status["master"]["address"], address());
  EXPECT_EQ(status["gateways"]["ready"], 1);
  EXPECT_EQ(status["gateways"]["lost"], 1);
  EXPECT_EQ(status["drivers"]["active"], 1);
  EXPECT_THAT(status["topologies"], SizeIs(0));
  EXPECT_THAT(run({"status"}).out, AllOf(HasSubstr("1 ready, 1 lost"), HasSubstr("1 active")));
}

TEST_F(Cli, WhatIsOrderedOfALostGatewayIsListedAndTakenAwayByItsName) {
  { FakeGateway gone(url, "lab2"); }
  ASSERT_TRUE(test::eventually([&] { return !(*master)->gateways().at(0).alive; }));
  ASSERT_EQ(run({"deploy", "turtle.so", "--gateway", "lab2", "--name", "rover", "--count", "2"}).status, 1);
  const auto listed = run_json({"drivers"});
  ASSERT_THAT(listed, SizeIs(2));
  EXPECT_EQ(listed[0]["name"], "rover");
  EXPECT_EQ(listed[0]["state"], "ordered");
  EXPECT_THAT(listed[0]["reason"].get<std::string>(), HasSubstr("its gateway is lost"));
  EXPECT_THAT(run_json({"drivers", "--state", "ordered"}), SizeIs(2));
  EXPECT_THAT(run({"status"}).out, HasSubstr("2 ordered"));
  run({"undeploy", "rover/1"});
  EXPECT_THAT(run_json({"drivers"}), SizeIs(1));
  run({"undeploy", "--name", "rover"});
  EXPECT_THAT(run_json({"drivers"}), SizeIs(0));
}

TEST_F(Cli, YamlSaysTheSameAsJson) {
  FakeGateway gateway(url, "lab1");
  const auto done = run({"gateways", "-o", "yaml"});
  EXPECT_EQ(done.status, 0);
  EXPECT_EQ(done.out,
            "- gateway: lab1\n  state: ready\n  draining: false\n  frozen: \"\"\n  host: \"127.0.0.1\"\n  port: "
            "12905\n  brokers:\n    "
            "- rabbitmq\n"
            "  since_ms: 1\n  trouble: \"\"\n");
}

TEST_F(Cli, ShowsAFrozenGatewayAndAdoptsTheRegistryForIt) {
  FakeGateway gateway(url, "lab1");
  const auto registry = test::open_registry(url);
  const discovery::Paths paths;
  const auto mark = discovery::freeze_path(paths, "lab1"_gateway);
  discovery::put(*registry, mark, encode(discovery::FreezeRecord{"it was emptied", 5, "token"}));
  EXPECT_THAT(run({"gateways"}).out, HasSubstr("ready, frozen"));
  EXPECT_EQ(json::parse(run({"gateways", "-o", "json"}).out)[0]["frozen"], "it was emptied");
  EXPECT_THAT(run({"status"}).out, HasSubstr("1 ready, 1 frozen: `iotcloud registry adopt`"));
  const auto thaws = registry->watch_node(paths.orders("lab1"_gateway), [&](const auto& node) {
    if (node && node->data.find("token") != std::string::npos) registry->remove(mark);
  });
  const auto done = run({"registry", "adopt", "lab1"});
  EXPECT_EQ(done.status, 0) << done.out << done.err;
  EXPECT_THAT(run({"status"}).out, Not(HasSubstr("frozen")));
}

TEST_F(Cli, FollowsTheLeaderWhenItAskedAStandby) {
  FakeGateway gateway(url, "lab1");
  auto options = TestMaster::quick();
  options.id = "m2";
  TestMaster standby(url, options);
  ASSERT_TRUE(test::eventually([&] { return standby->status().leader == address(); }));
  rpc::ThriftServer standby_server({}, serve_api(*standby));
  const auto at_standby = "127.0.0.1:" + std::to_string(standby_server.port());

  const auto deployed = run({"--master", at_standby, "deploy", "turtle.so", "--all"});
  EXPECT_EQ(deployed.status, 0) << deployed.err;
  EXPECT_THAT(gateway.orders(), SizeIs(1));
  const auto status = run({"--master", at_standby, "status"});
  EXPECT_THAT(status.out, HasSubstr("standby; " + address() + " leads"));
}

TEST_F(Cli, ALeaderThatDoesNotAnswerIsSaidWhenPatienceEnds) {
  auto options = TestMaster::quick();
  options.id = "m2";
  TestMaster standby(url, options);
  ASSERT_TRUE(test::eventually([&] { return standby->status().leader == address(); }));
  rpc::ThriftServer standby_server({}, serve_api(*standby));
  const auto leader = address();
  server.reset();
  std::ostringstream out, err;
  cli::Call call{out, err};
  call.election_patience = std::chrono::milliseconds(1);
  const auto at = "127.0.0.1:" + std::to_string(standby_server.port());
  EXPECT_EQ(cli::run_program({"--master", at, "deploy", "turtle.so", "--all"}, call), 3);
  EXPECT_THAT(err.str(), AllOf(HasSubstr("standby"), HasSubstr(leader)));
}

TEST_F(Cli, AnOrderWaitsForTheSuccessorOfALeaderThatDied) {
  FakeGateway gateway(url, "lab1");
  auto options = TestMaster::quick();
  options.id = "m2";
  options.address = "127.0.0.1:1";  // nobody is sent there: it leads before anyone asks it for the leader
  TestMaster standby(url, options);
  ASSERT_TRUE(test::eventually([&] { return standby->status().leader == address(); }));
  rpc::ThriftServer standby_server({}, serve_api(*standby));
  server.reset();  // the leader is silent, and the registry does not know it yet
  auto done = std::async(std::launch::async, [&] {
    std::ostringstream out, err;
    cli::Call call{out, err};
    const auto at = "127.0.0.1:" + std::to_string(standby_server.port());
    const int status = cli::run_program({"--master", at, "deploy", "turtle.so", "--all"}, call);
    return std::pair(status, err.str());
  });
  EXPECT_EQ(done.wait_for(std::chrono::milliseconds(50)), std::future_status::timeout);
  master->end();
  const auto [status, text] = done.get();
  EXPECT_EQ(status, 0) << text;
  EXPECT_THAT(gateway.orders(), SizeIs(1));
}

TEST_F(Cli, StatusIsSaidWhileTheRegistryIsAway) {
  const auto nowhere = test::open_registry("zookeeper://127.0.0.1:1");
  Master alone(*nowhere, TestMaster::quick());
  rpc::ThriftServer alone_server({}, serve_api(alone));
  const auto at = "127.0.0.1:" + std::to_string(alone_server.port());
  const auto table = run({"--master", at, "status"});
  EXPECT_EQ(table.status, 1);
  EXPECT_THAT(table.out, AllOf(HasSubstr("m1 at " + at), HasSubstr("away")));
  const auto answer = json::parse(run({"--master", at, "status", "-o", "json"}).out);
  EXPECT_EQ(answer["master"]["registry"], "away");
  EXPECT_THAT(run({"--master", at, "deploy", "turtle.so", "--all"}).err, HasSubstr("registry is away"));
}

TEST_F(Cli, AsksTheNextMasterWhenTheFirstIsAway) {
  FakeGateway gateway(url, "lab1");
  EXPECT_EQ(run({"--master", "127.0.0.1:1," + address(), "gateways"}).status, 0);
}

TEST_F(Cli, WithoutAMasterTheExitStatusIsThreeAndTheTextSaysHowToMendIt) {
  const auto done = run({"--master", "127.0.0.1:1", "drivers"});
  EXPECT_EQ(done.status, 3);
  EXPECT_THAT(done.err, AllOf(HasSubstr("127.0.0.1:1"), HasSubstr("--master"), HasSubstr("iotcloud-master")));
}

TEST_F(Cli, AMasterThatWantsATokenGetsItFromAFile) {
  FakeGateway gateway(url, "lab1");
  server.reset();
  const std::string file = testing::TempDir() + "iotcloud-token-" + std::to_string(getpid());
  const std::string tokens = file + "s";
  const std::string token = security::add_token(tokens, "anna", security::Role::viewer);
  ApiAccess access;
  access.tokens = std::make_shared<security::TokenKeeper>(tokens);
  server.emplace(rpc::ThriftServerOptions{}, serve_api(**master, access));
  const auto closed = run({"gateways"});
  EXPECT_EQ(closed.status, 1);
  EXPECT_THAT(closed.err, AllOf(HasSubstr("token"), HasSubstr("--token-file")));
  std::ofstream(file) << token << "\n";
  EXPECT_EQ(run({"--token-file", file, "gateways"}).status, 0);
  const auto from_environment =
      test::run_program({IOTCLOUD_CLI, "gateways"}, {{"IOTCLOUD_MASTER", address()}, {"IOTCLOUD_TOKEN", token}});
  EXPECT_EQ(from_environment.status, 0) << from_environment.err;
  const auto not_allowed = run({"--token-file", file, "deploy", "turtle.so", "--all"});
  EXPECT_EQ(not_allowed.status, 1);
  EXPECT_THAT(not_allowed.err, AllOf(HasSubstr("viewer"), HasSubstr("admin")));
  std::remove(file.c_str());
  std::remove(tokens.c_str());
}

TEST_F(Cli, ABackupGoesIntoAFileAndFromItIntoTheRegistry) {
  const std::string file = testing::TempDir() + "iotcloud-backup-" + std::to_string(getpid()) + ".json";
  std::string id;
  {
    FakeGateway gateway(url, "lab1");
    id = deploy("lab1");
  }
  const auto written = run({"registry", "export", file});
  EXPECT_EQ(written.status, 0) << written.err;
  EXPECT_THAT(written.out, HasSubstr(file + ": 1 orders of 1 gateways, 0 of topologies"));
  struct stat status {};
  ASSERT_EQ(stat(file.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600U) << "it has secrets";
  EXPECT_EQ(json::parse(run({"registry", "export"}).out)["gateways"][0]["orders"][0]["instance"], id);

  EXPECT_EQ(run_json({"registry", "import", file})["outcomes"][0]["reason"],
            "it stood there already; gateway is lost; it will follow the order when it comes back");
  discovery::remove_tree(master->registry(), discovery::Paths().orders("lab1"_gateway));
  const auto back = run({"registry", "import", file});
  EXPECT_EQ(back.status, 0) << back.err;
  EXPECT_THAT(back.out, AllOf(HasSubstr(id), HasSubstr("done")));
  EXPECT_EQ((*master)->orders().at(0).order.instance, id);

  std::ofstream(file) << "no backup";
  const auto wrong = run({"registry", "import", file});
  EXPECT_EQ(wrong.status, 1);
  EXPECT_THAT(wrong.err, AllOf(HasSubstr(file), HasSubstr("JSON")));
  std::remove(file.c_str());
  EXPECT_THAT(run({"registry", "import", file}).err, HasSubstr("cannot be read"));
}

TEST_F(Cli, WrongUsageHasExitStatusTwo) {
  for (const std::vector<std::string>& words :
       {std::vector<std::string>{},
        {"deploi"},
        {"deploy"},
        {"deploy", "turtle.so"},
        {"undeploy"},
        {"undeploy", "--gateway", "lab1"},
        {"undeploy", "3f2a", "--all"},
        {"stop", "3f2a", "--where", "site == 'lab'"},
        {"stop", "--where", "site == lab"},
        {"start", "--state", "lost"},
        {"drivers", "-o", "xml"},
        {"deploy", "turtle.so", "--all", "-p", "novalue"},
        {"deploy", "turtle.so", "--all", "--gateway", "lab1"},
        {"deploy", "turtle.so", "--all", "--count", "0"},
        {"deploy", "turtle.so", "--all", "-c", "kinect.dead_line=1"},
        {"deploy", "turtle.so", "--all", "-c", "kinect.priority=10"},
        {"deploy", "turtle.so", "--all", "-c", "priority=1"},
        {"deploy", "turtle.so", "--all", "-c", "a.priority=1", "-p", "channel.a.priority=1"},
        {"deploy", "turtle.so", "--all", "-c", "a.spool_full=block", "-c", "a.when_full=block"},
        {"deploy", "turtle.so", "--all", "--lease", "30s"},
        {"deploy", "turtle.so", "--all", "--on-partition", "stop"},
        {"deploy", "turtle.so", "--all", "--on-partition", "halt", "--lease", "30s"},
        {"deploy", "turtle.so", "--all", "--on-partition", "stop", "--lease", "30s", "-p", "lease=20s"},
        {"drain"},
        {"registry", "adopt"},
        {"registry", "adopt", "lab1", "--all"},
        {"registry", "import"},
        {"diff"},
        {"apply"},
        {"diff", "-f", "/nonexistent/fleet.yaml"},
        {"completion", "fish"},
        {"topology"},
        {"topology", "kill"},
        {"topology", "rebalance", "echo"},
        {"topology", "rebalance", "echo", "in"},
        {"topology", "rebalance", "echo", "in=0"},
        {"topology", "rebalance", "echo", "in=1", "in=2"},
        {"topology", "tap", "echo"},
        {"topology", "tap", "echo", "in", "--rate", "0"},
        {"--ca", "ca.pem", "status"},
        {"certs", "init", "folder"},
        {"certs", "add", "folder"},
        {"token", "add", "anna", "--file", "tokens"},
        {"token", "add", "anna", "--file", "tokens", "--role", "king"},
        {"--master", "nowhere", "status"}}) {
    const auto done = run(words);
    EXPECT_EQ(done.status, 2) << testing::PrintToString(words) << done.out << done.err;
    EXPECT_FALSE(done.err.empty());
  }
}

/// The words of each verb's command, as the command line names it. \param words those of `above`
void add_commands(CLI::App& above, const std::vector<std::string>& words,
                  std::vector<std::vector<std::string>>& commands) {
  for (CLI::App* below : above.get_subcommands([](const CLI::App*) { return true; })) {
    auto command = words;
    command.push_back(below->get_name());
    const std::size_t before = commands.size();
    add_commands(*below, command, commands);
    if (commands.size() == before) commands.push_back(command);
  }
}

TEST_F(Cli, EveryCommandHasHelpWithAnExample) {
  CLI::App app;
  cli::Format format = cli::Format::table;
  cli::Verbs verbs(app, format);
  for (const auto add_family : cli::families) add_family(verbs);
  std::vector<std::vector<std::string>> commands;
  add_commands(app, {}, commands);
  EXPECT_EQ(commands.size(), verbs.all().size());
  for (auto words : commands) {
    const std::string command = fmt::format("{}", fmt::join(words, " "));
    words.emplace_back("--help");
    const auto done = run(words);
    EXPECT_EQ(done.status, 0) << command;
    const auto example = done.out.find("Example:");
    ASSERT_NE(example, std::string::npos) << command;
    EXPECT_THAT(done.out.substr(example), AllOf(HasSubstr("iotcloud "), HasSubstr(" " + command))) << command;
  }
  EXPECT_THAT(run({"--help"}).out, HasSubstr("Exit status"));
}

TEST_F(Cli, ATopologyIsListedWithItsStateAndOrderedToChange) {
  const discovery::Paths paths;
  auto& registry = master->registry();
  discovery::TopologyRecord record;
  record.name = "echo"_topology;
  record.spouts = {"in"};
  discovery::put(registry, paths.topology("echo"_topology), encode(record));
  discovery::WorkerRecord worker;
  worker.name = "w1";
  worker.state = "active";
  worker.components = {{"in", {1, 2}}};
  const auto path = paths.workers("echo"_topology) + "/w1";
  const auto node = registry.hold(path, encode(worker));
  const auto orders = registry.watch_node(paths.topology_order("echo"_topology), [&](const auto& order) {
    if (!order) return;
    const auto wanted = discovery::decode_topology_order(order->data, "order");
    worker.state = wanted.active ? "active" : "inactive";
    worker.revision = wanted.revision;
    registry.set(path, encode(worker));
  });
  EXPECT_EQ(run_json({"topology", "list"})[0]["state"], "active");
  const auto answer = run_json({"topology", "deactivate", "echo"});
  EXPECT_EQ(answer["ok"], true);
  EXPECT_EQ(answer["outcomes"][0], (json{{"worker", "w1"}, {"host", ""}, {"outcome", "done"}, {"reason", ""}}));
  EXPECT_EQ(run_json({"topologies"})[0]["state"], "inactive");
  EXPECT_THAT(run({"topology", "rebalance", "echo", "in=2"}).out, AllOf(HasSubstr("w1"), HasSubstr("done")));

  auto refused = run({"topology", "rebalance", "echo", "in=3"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, HasSubstr("1 to 2"));
  refused = run({"topology", "metrics", "ehco"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, HasSubstr("there are echo"));
  refused = run({"topology", "metrics", "echo"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, HasSubstr("serves no pages"));
}

TEST_F(Cli, ATopologyWithoutAWorkerIsNotShownAsActive) {
  const discovery::Paths paths;
  auto& registry = master->registry();
  discovery::TopologyRecord record;
  record.name = "echo"_topology;
  discovery::put(registry, paths.topology("echo"_topology), encode(record));
  discovery::WorkerRecord worker;
  worker.name = "w1";
  worker.state = "active";
  auto node = registry.hold(paths.workers("echo"_topology) + "/w1", encode(worker));
  ASSERT_EQ(run_json({"topology", "list"})[0]["state"], "active");

  node.reset();  // its only worker died
  ASSERT_TRUE(test::eventually([&] { return (*master)->topologies().at(0).workers.empty(); }));
  EXPECT_EQ(run_json({"topology", "list"})[0]["state"], "no worker");
  EXPECT_EQ(run_json({"topologies"})[0]["state"], "no worker");
  const auto shown = run({"topology", "show", "echo"});
  EXPECT_EQ(shown.status, 1);
  EXPECT_THAT(shown.out, HasSubstr("echo: no worker, 0 workers"));
  EXPECT_THAT(shown.err, HasSubstr("no worker of topology echo runs"));
  EXPECT_THAT(run({"status"}).out, AllOf(HasSubstr("echo (0 workers)"), HasSubstr("echo: no worker runs")));
}

TEST_F(Cli, WhatOthersWroteCannotSteerTheTerminal) {
  FakeGateway gateway(url, "lab1", FakeGateway::fail("\x1b[2Jgone\nnext"));
  const auto done = run({"deploy", "turtle.so", "--all"});
  EXPECT_THAT(done.out, AllOf(HasSubstr("[2Jgone next"), Not(HasSubstr("\x1b"))));
}

}  // namespace
}  // namespace iotcloud::master
