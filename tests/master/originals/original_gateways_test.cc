#include <atomic>
#include <fstream>
#include <future>
#include <iterator>
#include <mutex>
#include <optional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <thrift/TProcessor.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TSocket.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include "iotcloud/master/TMasterService.h"
#include <iotcloud/master/originals/gateway_handler.h>
#include <iotcloud/master/originals/original_gateways.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>
#include <iotcloud/tests/rpc/as_nobody.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/servers/free_port.h>

namespace iotcloud::master {
namespace {

using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TFramedTransport;
using apache::thrift::transport::TSocket;
using discovery::DriverState;
using discovery::wire::TChannel;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;
using discovery::wire::TSensor;
using discovery::wire::TSensorDeployDescriptor;
using discovery::wire::TSensorState;
using discovery::wire::TSite;
using std::chrono::milliseconds;
using test::TestMaster;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

/// A connection to the master's port for gateways.
struct ToMaster {
  explicit ToMaster(int port)
      : transport(std::make_shared<TFramedTransport>(std::make_shared<TSocket>("127.0.0.1", port))) {
    transport->open();
    client = std::make_unique<wire::TMasterServiceClient>(std::make_shared<TBinaryProtocol>(transport));
  }
  wire::TMasterServiceClient* operator->() { return client.get(); }

  std::shared_ptr<TFramedTransport> transport;
  std::unique_ptr<wire::TMasterServiceClient> client;
};

TSensor turtle(const std::string& id) {
  TSensor sensor;
  sensor.name = "turtle";
  sensor.state = TSensorState::DEPLOY;
  sensor.metadata = "bytes of its own";
  sensor.__set_sensorId(id);
  TChannel channel;
  channel.transport = "rabbitmq";
  channel.direction = discovery::wire::TDirection::OUT;
  channel.__set_name("kinect");
  channel.__set_brokerUrl("amqp://127.0.0.1:5672");
  sensor.channels = {channel};
  return sensor;
}

/// A gateway of the original system: answers SUCCESS at once, does what it was told afterwards, and tells the master.
class OriginalGateway final : public gateway::wire::TSensorSiteServiceIf {
 public:
  explicit OriginalGateway(int master_port) : master_port_(master_port) {}

  void hearbeat(discovery::wire::THeartBeatResponse& response, const discovery::wire::THeartBeatRequest&) override {
    ++heartbeats;
    response.__set_totalSensors(0);
    response.__set_responsiveSonsor(0);
  }
  void deploySensor(TResponse& response, const TSensorDeployDescriptor& descriptor) override {
    {
      std::lock_guard lock(mutex_);
      plugins_.push_back(descriptor.filename);
    }
    response.__set_state(refuse ? TResponseState::FAILURE : TResponseState::SUCCESS);
    response.__set_statusMessage(refuse ? "no such jar" : "");
    if (refuse || silent) return;
    later_ = std::async(std::launch::async, [this, id = "original" + std::to_string(++deployed_)] {
      TResponse answer;
      ToMaster(master_port_)->registerSensor(answer, "java1", turtle(id));
    });
  }
  void unDeploySensor(TResponse& response, const std::string& id) override { say(response, "undeploy " + id); }
  void startSensor(TResponse& response, const std::string& id) override { say(response, "start " + id); }
  void stopSensor(TResponse& response, const std::string& id) override { say(response, "stop " + id); }
  void authenticate(TResponse&, const std::string&) override {}
  void ping(gateway::wire::TPing&) override {}
  void getChanges(std::vector<gateway::wire::TStateChange>&, const std::string&) override {}
  void getCarried(std::vector<gateway::wire::TCarried>&) override {}
  void listPlugins(std::vector<discovery::wire::TKnownPlugin>&) override {}
  void readLog(gateway::wire::TLogPart&, const std::string&, const std::string&, std::int32_t) override {}
  void lookAtChannel(discovery::wire::TChannelLook&, const discovery::wire::TLookRequest&) override {}
  void handMessage(discovery::wire::TChannelLook&, const discovery::wire::THandedMessage&) override {}
  void offerPlugin(std::string&, const gateway::wire::TPluginOffer&) override {}
  void sendPlugin(const std::string&, std::int64_t, const std::string&) override {}
  void finishPlugin(const std::string&) override {}

  void say(TResponse& response, const std::string& call) {
    {
      std::lock_guard lock(mutex_);
      calls_.push_back(call);
    }
    response.__set_state(TResponseState::SUCCESS);
  }

  std::atomic<int> heartbeats{0};
  std::atomic<bool> refuse{false};
  std::atomic<bool> silent{false};
  std::vector<std::string> plugins() const {
    std::lock_guard lock(mutex_);
    return plugins_;
  }
  std::vector<std::string> calls() const {
    std::lock_guard lock(mutex_);
    return calls_;
  }

 private:
  const int master_port_;
  std::atomic<int> deployed_{0};
  mutable std::mutex mutex_;
  std::vector<std::string> plugins_;  ///< guarded by mutex_
  std::vector<std::string> calls_;    ///< guarded by mutex_
  std::future<void> later_;           ///< of the one connection that orders
};

class OriginalGatewayTest : public testing::Test {
 protected:
  OriginalGatewayTest() {
    OriginalGatewaysOptions options;
    options.heartbeat_interval = milliseconds(5);
    options.heartbeat_limit = milliseconds(1000);
    registry = test::open_registry(url);
    originals.emplace(*registry, options);
    auto master_options = TestMaster::quick();
    master_options.direct = &*originals;
    master.emplace(url, master_options);
    EXPECT_TRUE(master->leads());
    originals->start([this] { return (*master)->status().leading; });
    for_gateways.emplace(rpc::ThriftServerOptions{},
                         serve_original_gateways(*originals, [this] { return (*master)->status(); }));
    gateway = std::make_shared<OriginalGateway>(for_gateways->port());
    serve_gateway(iotcloud::tests::free_port());  // one that nobody takes while the gateway is away
  }
  ~OriginalGatewayTest() override {
    for_gateways.reset();
    originals->stop();
    master.reset();
  }

  void serve_gateway(int port) {
    rpc::ThriftServerOptions options;
    options.port = port;
    gateway_server.emplace(options, [p = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(gateway)](
                                        const auto&) { return p; });
  }
  TSite site() const {
    TSite out;
    out.siteId = "java1";
    out.host = "127.0.0.1";
    out.port = gateway_server->port();
    return out;
  }
  TResponse register_site(const TSite& site) const {
    TResponse response;
    ToMaster(for_gateways->port())->registerSite(response, site);
    return response;
  }
  bool alive() {
    const auto gateways = (*master)->gateways();
    return gateways.size() == 1 && gateways[0].alive;
  }
  static DeployRequest jar() {
    DeployRequest request;
    request.plugin = "turtle.jar";
    request.driver = "cgl.iotcloud.turtle.TurtleSensor"_driver;
    return request;
  }

  const std::string url = test::fresh_registry_url();
  const discovery::Paths paths;
  std::unique_ptr<discovery::Registry> registry;
  std::optional<OriginalGateways> originals;
  std::optional<TestMaster> master;
  std::optional<rpc::ThriftServer> for_gateways;
  std::shared_ptr<OriginalGateway> gateway;
  std::optional<rpc::ThriftServer> gateway_server;
};

TEST_F(OriginalGatewayTest, RegistersAndIsAskedForHeartbeats) {
  EXPECT_EQ(register_site(site()).state, TResponseState::SUCCESS);
  EXPECT_TRUE(alive());
  EXPECT_TRUE(test::eventually([&] { return gateway->heartbeats > 2; }));
}

TEST_F(OriginalGatewayTest, IsLostAfterSeveralMissesAndComesBackByItself) {
  register_site(site());
  const int port = gateway_server->port();
  gateway_server.reset();
  EXPECT_TRUE(test::eventually([&] { return !alive(); }));
  serve_gateway(port);
  EXPECT_TRUE(test::eventually([&] { return alive(); }));
}

TEST_F(OriginalGatewayTest, DeployIsDoneWhenItHasRegisteredTheDriver) {
  register_site(site());
  const auto result = (*master)->deploy(jar());
  ASSERT_TRUE(result.all_done()) << result.summary();
  ASSERT_THAT(result.outcomes, SizeIs(1));
  EXPECT_EQ(result.outcomes[0].instance, "original1");
  EXPECT_THAT(gateway->plugins(), SizeIs(1));
  const auto drivers = (*master)->drivers();
  ASSERT_THAT(drivers, SizeIs(1));
  EXPECT_EQ(drivers[0].gateway, "java1");
  EXPECT_EQ(drivers[0].state, DriverState::active);
  const auto channel = registry->get(paths.channel("turtle"_driver, "original1"_instance, "kinect"));
  ASSERT_TRUE(channel);
  EXPECT_EQ(discovery::decode_channel(channel->data, "").broker_url, "amqp://127.0.0.1:5672");
}

TEST_F(OriginalGatewayTest, DeployIsUnknownWhenItSaysSuccessAndRegistersNothing) {
  register_site(site());
  gateway->silent = true;
  auto request = jar();
  request.wait = milliseconds(100);
  EXPECT_EQ((*master)->deploy(request).outcomes.at(0).outcome, OrderOutcome::unknown);
}

TEST_F(OriginalGatewayTest, DeployFailsWithItsWords) {
  register_site(site());
  gateway->refuse = true;
  const auto result = (*master)->deploy(jar());
  EXPECT_EQ(result.outcomes.at(0).outcome, OrderOutcome::failed);
  EXPECT_THAT(result.outcomes.at(0).reason, HasSubstr("no such jar"));
}

TEST_F(OriginalGatewayTest, StartCallsStartAndStopCallsStop) {
  register_site(site());
  const auto id = (*master)->deploy(jar()).outcomes.at(0).instance;
  EXPECT_TRUE((*master)->stop({{id}, {}, {}}).all_done());
  EXPECT_EQ((*master)->drivers().at(0).state, DriverState::inactive);
  EXPECT_TRUE((*master)->start({{id}, {}, {}}).all_done());
  EXPECT_EQ((*master)->drivers().at(0).state, DriverState::active);
  EXPECT_TRUE((*master)->undeploy({{id}, {}, {}}).all_done());
  EXPECT_THAT((*master)->drivers(), IsEmpty());
  EXPECT_EQ(gateway->calls(), (std::vector<std::string>{"stop " + id, "start " + id, "undeploy " + id}));
}

TEST_F(OriginalGatewayTest, ASecondGatewayWithTheSameIdIsRefused) {
  register_site(site());
  auto other = site();
  other.port = 9;
  const auto response = register_site(other);
  EXPECT_EQ(response.state, TResponseState::FAILURE);
  EXPECT_THAT(response.statusMessage, HasSubstr("another gateway with the id java1"));
  EXPECT_EQ(register_site(site()).state, TResponseState::SUCCESS) << "the same one may register again";
}

TEST_F(OriginalGatewayTest, AnIdOfAGatewayOfThisSystemIsRefused) {
  std::optional<test::FakeGateway> ours(std::in_place, url, "java1");
  const auto order = [&] { return (*master)->deploy(jar()).outcomes; };
  ASSERT_THAT(order(), SizeIs(1));
  const std::string id = (*master)->drivers().at(0).instance;
  EXPECT_EQ(register_site(site()).state, TResponseState::FAILURE);
  ours.reset();
  ASSERT_TRUE(test::eventually([&] { return !alive(); }));
  const auto response = register_site(site());
  EXPECT_EQ(response.state, TResponseState::FAILURE) << "its deployments would go to whoever registers its id";
  EXPECT_THAT(response.statusMessage, HasSubstr("java1 is a gateway of this system"));

  auto own = site();
  own.siteId = "java2";
  ASSERT_EQ(register_site(own).state, TResponseState::SUCCESS);
  TResponse registered;
  ToMaster(for_gateways->port())->registerSensor(registered, "java2", turtle(id));
  EXPECT_THAT(registered.statusMessage, HasSubstr("an instance of another gateway"));
  EXPECT_EQ((*master)->drivers().at(0).gateway, "java1");
}

TEST_F(OriginalGatewayTest, AnIdOfAUserOfTheRegistryIsRefusedAlsoIfItsGatewayNeverRegistered) {
  OriginalGatewaysOptions options;
  options.access = std::make_shared<const discovery::RegistryAccess>(
      std::vector<discovery::RegistryUser>{{discovery::RegistryUser::Role::gateway, "java1", "digest"},
                                           {discovery::RegistryUser::Role::worker, "java2", "digest"}},
      paths);
  OriginalGateways with_users(*registry, options);
  discovery::GatewayRecord record;
  record.id = "java1"_gateway;
  record.host = "127.0.0.1";
  record.port = 12903;
  EXPECT_THAT(with_users.register_gateway(record), HasSubstr("as registry.users says"));
  EXPECT_FALSE(registry->get(paths.gateway("java1"_gateway)));
  record.id = "java2"_gateway;
  EXPECT_EQ(with_users.register_gateway(record), "");
}

TEST_F(OriginalGatewayTest, NamesThatCannotStandInTheRegistryAreRefused) {
  auto bad = site();
  bad.siteId = "../sensors";
  EXPECT_EQ(register_site(bad).state, TResponseState::FAILURE);
  register_site(site());
  TResponse response;
  auto sensor = turtle("a/b");
  ToMaster(for_gateways->port())->registerSensor(response, "java1", sensor);
  EXPECT_EQ(response.state, TResponseState::FAILURE);
  ToMaster(for_gateways->port())->registerSensor(response, "stranger", turtle("x1"));
  EXPECT_THAT(response.statusMessage, HasSubstr("registerSite"));
}

TEST_F(OriginalGatewayTest, WhatItUnregistersGoes) {
  register_site(site());
  ToMaster to_master(for_gateways->port());
  TResponse response;
  to_master->registerSensor(response, "java1", turtle("x1"));
  to_master->registerSensor(response, "java1", turtle("x2"));
  EXPECT_EQ(response.state, TResponseState::SUCCESS);
  to_master->unRegisterSensor(response, "java1", "x1");
  EXPECT_EQ(response.state, TResponseState::SUCCESS);
  EXPECT_THAT((*master)->drivers(), SizeIs(1));
  to_master->unRegisterSite(response, site());
  EXPECT_EQ(response.state, TResponseState::SUCCESS);
  EXPECT_THAT((*master)->drivers(), IsEmpty());
  EXPECT_THAT((*master)->gateways(), IsEmpty());
}

TEST_F(OriginalGatewayTest, WhatItUnregistersIsNothingOfOthersWhateverARecordThatNamesItSays) {
  register_site(site());
  discovery::DriverRecord victim;
  victim.name = "turtle"_driver;
  victim.instance = "victim"_instance;
  victim.gateway = "lab2"_gateway;
  const auto its_record = paths.instance("turtle"_driver, "victim"_instance);
  discovery::put(*registry, its_record, encode(victim));
  victim.gateway = "java1"_gateway;
  discovery::put(*registry, paths.instance("turtle"_driver, "mine"_instance), encode(victim));
  TResponse response;
  ToMaster(for_gateways->port())->unRegisterSite(response, site());
  EXPECT_EQ(response.state, TResponseState::SUCCESS) << response.statusMessage;
  EXPECT_TRUE(registry->get(its_record));
  EXPECT_FALSE(registry->get(paths.instance("turtle"_driver, "mine"_instance)));
}

TEST_F(OriginalGatewayTest, IsTendedByTheMasterThatComesToLeadNext) {
  register_site(site());
  for_gateways.reset();
  originals->stop();
  ASSERT_FALSE(alive());
  OriginalGatewaysOptions options;
  options.heartbeat_interval = milliseconds(5);
  OriginalGateways next(*registry, options);
  next.start([] { return true; });
  EXPECT_TRUE(test::eventually([&] { return alive(); }));
  EXPECT_TRUE(next.has("java1"_gateway));
  next.stop();
}

TEST_F(OriginalGatewayTest, OfAnotherUserOfTheMachineIsRefusedUnlessThatOneIsNamedAndInTheAuditLog) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can make a socket of another user";
  const tests::TemporaryFolder folder;
  const auto serve = [&](OriginalAccess access) {
    for_gateways.reset();  // it has the log
    access.audit = std::make_shared<security::AuditLog>(folder / "audit");
    for_gateways.emplace(rpc::ThriftServerOptions{}, serve_original_gateways(
                                                         *originals, [this] { return (*master)->status(); }, access));
  };
  const auto register_as_nobody = [&] {
    const rpc::test::AsNobody nobody;
    return register_site(site());
  };
  serve({});
  const auto refused = register_as_nobody();
  EXPECT_EQ(refused.state, TResponseState::FAILURE);
  EXPECT_THAT(refused.statusMessage, HasSubstr("users"));
  EXPECT_FALSE(originals->has("java1"_gateway));
  serve({.users = {"nobody"}});
  EXPECT_EQ(register_as_nobody().state, TResponseState::SUCCESS);
  serve({.open = true});
  EXPECT_EQ(register_as_nobody().state, TResponseState::SUCCESS);
  for_gateways.reset();
  std::ifstream in(folder / "audit");
  const std::string lines(std::istreambuf_iterator<char>(in), {});
  EXPECT_THAT(lines, testing::AllOf(HasSubstr("\"refused\":true"), HasSubstr("\"event\":\"begun\""),
                                    HasSubstr("\"who\":\"user 65534\""), HasSubstr("java1 at 127.0.0.1:")));
}

TEST_F(OriginalGatewayTest, AStandbyMasterRefusesAndNamesTheLeader) {
  rpc::ThriftServer standby({}, serve_original_gateways(*originals, [] {
                              MasterStatus status;
                              status.id = "m2";
                              status.leader = "10.0.0.1:12904";
                              return status;
                            }));
  TResponse response;
  ToMaster(standby.port())->registerSite(response, site());
  EXPECT_EQ(response.state, TResponseState::FAILURE);
  EXPECT_THAT(response.statusMessage, HasSubstr("10.0.0.1:12904"));
}

}  // namespace
}  // namespace iotcloud::master
