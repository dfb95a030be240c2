#include <filesystem>
#include <fstream>
#include <future>
#include <optional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TSocket.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/master/api/api_handler.h>
#include <iotcloud/master/api/wire.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>
#include <iotcloud/tests/master/process.h>

namespace iotcloud::master {
namespace {

using apache::thrift::TApplicationException;
using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TFramedTransport;
using apache::thrift::transport::TSocket;
using apache::thrift::transport::TTransportException;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;
using discovery::wire::TSensor;
using discovery::wire::TSite;
using test::FakeGateway;
using test::TestMaster;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Pair;
using testing::SizeIs;

struct Connection {
  explicit Connection(int port) : socket(std::make_shared<TSocket>("127.0.0.1", port)) {
    socket->setRecvTimeout(std::chrono::milliseconds(test::patience).count());
    transport = std::make_shared<TFramedTransport>(socket);
    transport->open();
    client = std::make_unique<wire::TMasterAPIServiceClient>(std::make_shared<TBinaryProtocol>(transport));
  }
  wire::TMasterAPIServiceClient* operator->() { return client.get(); }

  std::shared_ptr<TSocket> socket;
  std::shared_ptr<TFramedTransport> transport;
  std::unique_ptr<wire::TMasterAPIServiceClient> client;
};

class MasterServer : public testing::Test {
 protected:
  MasterServer() {
    EXPECT_TRUE(master.leads());
    serve();
  }
  void serve(const rpc::ThriftServerOptions& options = {}) {
    server.reset();
    server.emplace(options, serve_api(*master));
  }

  const std::string url = test::fresh_registry_url();
  TestMaster master{url};
  std::optional<rpc::ThriftServer> server;
};

TEST_F(MasterServer, AClientDeploysListsAndUndeploys) {
  FakeGateway gateway(url, "lab1");
  Connection client(server->port());

  wire::TDeployRequest request;
  request.plugin = "turtle.so";
  request.properties = {{"source", "simulation"}};
  wire::TOrderResponse answer;
  client->deploy(answer, request);
  ASSERT_EQ(answer.response.state, TResponseState::SUCCESS) << answer.response.statusMessage;
  ASSERT_THAT(answer.outcomes, SizeIs(1));
  EXPECT_EQ(answer.outcomes[0].outcome, wire::TOutcome::DONE);
  EXPECT_EQ(gateway.orders().at(0).properties.at("source"), "simulation");

  std::vector<TSensor> drivers;
  client->listDrivers(drivers);
  ASSERT_THAT(drivers, SizeIs(1));
  EXPECT_EQ(drivers[0].sensorId, answer.outcomes[0].instance);
  EXPECT_EQ(drivers[0].exactState, "active");
  EXPECT_EQ(drivers[0].sinceMs, 1000);
  ASSERT_THAT(drivers[0].channels, SizeIs(1));
  EXPECT_EQ(drivers[0].channels[0].name, "kinect");

  std::vector<TSite> gateways;
  client->listGateways(gateways);
  ASSERT_THAT(gateways, SizeIs(1));
  EXPECT_TRUE(gateways[0].alive);

  wire::TInstanceSelection selection;
  selection.instances = {answer.outcomes[0].instance};
  client->undeploy(answer, selection);
  EXPECT_EQ(answer.response.state, TResponseState::SUCCESS) << answer.response.statusMessage;
  drivers.clear();
  client->listDrivers(drivers);
  EXPECT_THAT(drivers, SizeIs(0));
}

TEST_F(MasterServer, AFailedDeploymentIsAFailureWithTheReason) {
  FakeGateway gateway(url, "lab1", FakeGateway::fail("no such plugin"));
  Connection client(server->port());
  wire::TDeployRequest request;
  request.plugin = "turtel.so";
  wire::TOrderResponse answer;
  client->deploy(answer, request);
  EXPECT_EQ(answer.response.state, TResponseState::FAILURE);
  EXPECT_THAT(answer.response.statusMessage, HasSubstr("no such plugin"));
  ASSERT_THAT(answer.outcomes, SizeIs(1));
  EXPECT_EQ(answer.outcomes[0].outcome, wire::TOutcome::FAILED);
}

TEST_F(MasterServer, AWaitLimitOfTheClientIsKept) {
  FakeGateway gateway(url, "lab1", FakeGateway::say_nothing());
  Connection client(server->port());
  wire::TDeployRequest request;
  request.plugin = "turtle.so";
  request.waitMs = 50;
  wire::TOrderResponse answer;
  client->deploy(answer, request);
  EXPECT_EQ(answer.response.state, TResponseState::FAILURE);
  EXPECT_EQ(answer.outcomes.at(0).outcome, wire::TOutcome::UNKNOWN);
}

TEST_F(MasterServer, StatusAndTopologiesAreAnswered) {
  discovery::TopologyRecord topology;
  topology.name = "follower"_topology;
  topology.spouts = {"kinect_receive"};
  topology.bolts = {"decode", "control_send"};
  topology.since_ms = 5;
  const discovery::Paths paths;
  discovery::put(master.registry(), paths.topology("follower"_topology), encode(topology));
  const auto worker = master.registry().hold(paths.workers("follower"_topology) + "/w1", "");

  Connection client(server->port());
  std::vector<wire::TTopology> topologies;
  client->listTopologies(topologies);
  ASSERT_THAT(topologies, SizeIs(1));
  EXPECT_EQ(topologies[0].name, "follower");
  EXPECT_THAT(topologies[0].workers, SizeIs(1));
  EXPECT_THAT(topologies[0].bolts, SizeIs(2));
  wire::TMasterStatus status;
  client->getStatus(status);
  EXPECT_TRUE(status.leading);
  EXPECT_EQ(status.id, "m1");
  EXPECT_EQ(status.leader, "127.0.0.1:1111");
}

TEST(MasterAnswers, SayOfATopologyWhatIsWantedWhoWorksAndTheLastOrder) {
  discovery::TopologyStatus topology;
  topology.record.name = "follower"_topology;
  topology.record.bolts = {"decode"};
  topology.workers.emplace_back().name = "w1";
  topology.workers[0].trouble = "red is away";
  auto said = discovery::as_wire<wire::TTopology>(topology);
  EXPECT_EQ(said.name, "follower");
  EXPECT_THAT(said.workers, ElementsAre("w1"));
  EXPECT_EQ(said.wanted, "active");
  EXPECT_EQ(said.revision, 0);
  topology.order.emplace().revision = 7;
  topology.order->active = false;
  said = discovery::as_wire<wire::TTopology>(topology);
  EXPECT_EQ(said.wanted, "inactive");
  auto heard = discovery::as_own<discovery::TopologyStatus>(said);
  EXPECT_EQ(heard.record, topology.record);
  EXPECT_EQ(heard.workers, topology.workers);
  ASSERT_TRUE(heard.order);
  EXPECT_EQ(heard.order->revision, 7);
  EXPECT_FALSE(heard.order->active);
  topology.order->kill.emplace();
  said = discovery::as_wire<wire::TTopology>(topology);
  EXPECT_EQ(said.wanted, "killed");
  heard = discovery::as_own<discovery::TopologyStatus>(said);
  EXPECT_TRUE(heard.order && heard.order->kill);
}

TEST(MasterAnswers, SayOfAGatewayAndOfAnOrderAllThatIsKnown) {
  discovery::GatewayStatus gateway;
  gateway.record.id = discovery::GatewayId("lab1");
  gateway.record.brokers = {"red", "blue"};
  gateway.alive = gateway.draining = gateway.original = true;
  auto site = discovery::as_wire<TSite>(gateway);
  EXPECT_FALSE(site.__isset.frozen);
  gateway.frozen = "the registry was emptied";
  site = discovery::as_wire<TSite>(gateway);
  const auto heard = discovery::as_own<discovery::GatewayStatus>(site);
  EXPECT_EQ(heard.record, gateway.record);
  EXPECT_TRUE(heard.alive && heard.draining && heard.original);
  EXPECT_EQ(heard.frozen, gateway.frozen);

  discovery::PlacedOrder placed{discovery::GatewayId("lab1"), {}};
  placed.order.instance = discovery::InstanceId("01");
  placed.order.index = 2;
  placed.order.active = false;
  placed.order.drained = true;
  placed.order.properties = {{"rate", "5"}, {"password", "sesame"}};
  const auto listing = discovery::as_own<ListedOrder>(discovery::as_wire<wire::TOrder>(listed(placed, false)));
  EXPECT_EQ(listing.gateway, placed.gateway);
  EXPECT_EQ(listing.order.instance, placed.order.instance);
  EXPECT_EQ(listing.order.index, 2);
  EXPECT_TRUE(listing.order.active) << "it is stopped only while its gateway drains";
  EXPECT_THAT(listing.order.properties, ElementsAre(Pair("rate", "5")));
  EXPECT_THAT(listing.hidden, ElementsAre("password"));
}

TEST_F(MasterServer, AMessageAboveTheLimitClosesTheConnectionAndTheServerGoesOn) {
  rpc::ThriftServerOptions options;
  options.max_message_bytes = 10'000;
  serve(options);
  Connection client(server->port());
  TSite ignored;
  discovery::wire::TSiteDetailsResponse answer;
  EXPECT_THROW(client->getSite(answer, std::string(20'000, 'x')), TTransportException);
  Connection other(server->port());
  std::vector<std::string> sites;
  other->getSites(sites);
}

TEST_F(MasterServer, BytesThatAreNoThriftDoNotHarm) {
  TSocket socket("127.0.0.1", server->port());
  socket.open();
  const std::string frame("\0\0\0\x08\xff\xff\xff\xff\x7f\xff\xff\xff", 12);
  socket.write(reinterpret_cast<const std::uint8_t*>(frame.data()), static_cast<std::uint32_t>(frame.size()));
  Connection other(server->port());
  std::vector<std::string> sites;
  other->getSites(sites);
}

TEST_F(MasterServer, IdleClientsDoNotHoldUpTheStop) {
  Connection idle(server->port());
  std::vector<std::string> sites;
  idle->getSites(sites);
  auto stopped = std::async(std::launch::async, [&] { server.reset(); });
  EXPECT_EQ(stopped.wait_for(test::patience), std::future_status::ready);
}

TEST_F(MasterServer, AnOrderUnderWayDoesNotHoldUpTheStopOnceTheMasterCloses) {
  FakeGateway silent(url, "lab1", FakeGateway::say_nothing());
  auto answered = std::async(std::launch::async, [port = server->port()] {
    Connection client(port);
    wire::TDeployRequest request;
    request.plugin = "turtle.so";
    request.waitMs = 600'000;
    wire::TOrderResponse answer;
    client->deploy(answer, request);
    return answer;
  });
  ASSERT_TRUE(silent.wait_for_orders(1));
  master->close();
  server.reset();
  EXPECT_EQ(answered.get().outcomes.at(0).outcome, wire::TOutcome::UNKNOWN);
}

TEST_F(MasterServer, APortInUseIsAnErrorThatNamesIt) {
  rpc::ThriftServerOptions options;
  options.port = server->port();
  try {
    rpc::ThriftServer second(options, serve_api(*master));
    FAIL() << "the port is taken";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("127.0.0.1:" + std::to_string(options.port)));
  }
}

TEST_F(MasterServer, AClientCompiledFromTheOriginalIdlListsAndDeploys) {
  FakeGateway gateway(url, "lab1");
  const auto generated = std::filesystem::path(IOTCLOUD_TEST_DIR) / "original_client";
  const auto client = test::run_program({"/usr/bin/python3", IOTCLOUD_MASTER_TESTS "/originals/original_client.py",
                                         std::to_string(server->port()), generated.string()});
  EXPECT_EQ(client.status, 0) << client.out << client.err;
}

}  // namespace
}  // namespace iotcloud::master
