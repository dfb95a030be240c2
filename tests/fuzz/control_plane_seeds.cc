#include <memory>

#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include "iotcloud/master/TMasterAPIService.h"
#include "iotcloud/master/TMasterService.h"
#include "iotcloud/tests/fuzz/seeds.h"
#include "iotcloud/topology/pool/TPoolService.h"
#include "iotcloud/topology/storm/Nimbus.h"

namespace iotcloud::fuzz {

namespace {

using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TFramedTransport;
using apache::thrift::transport::TMemoryBuffer;

/// The bytes that a client sends.
template <typename Client, typename Calls>
std::string sent(const Calls& calls) {
  const auto buffer = std::make_shared<TMemoryBuffer>();
  Client client(std::make_shared<TBinaryProtocol>(std::make_shared<TFramedTransport>(buffer)));
  calls(client);
  return buffer->getBufferAsString();
}

/// The bytes that a service answers to calls.
template <typename Client, typename Processor, typename Handler, typename Calls>
std::string answered(const Calls& calls) {
  const auto plain = [](const std::shared_ptr<TMemoryBuffer>& buffer) {
    return std::make_shared<TBinaryProtocol>(std::make_shared<TFramedTransport>(buffer));
  };
  const auto asked = std::make_shared<TMemoryBuffer>();
  const auto told = std::make_shared<TMemoryBuffer>();
  Client client(plain(asked));
  calls(client);
  Processor(std::make_shared<Handler>()).process(plain(asked), plain(told), nullptr);
  return told->getBufferAsString();
}

// hash of the word "bytes"
const std::string sha256_of_bytes = "277089d91c0bdf4f2e6862ba7e4a07605119431f5d13f726dd352b06f1b206a9";

/// Plugin calls, for the master and for a gateway.
template <typename Offer>
Offer offer() {
  Offer offer;
  offer.__set_plugin("turtle.so");
  offer.__set_sha256(sha256_of_bytes);
  offer.__set_size(5);
  offer.__set_signature(std::string(64, 's'));
  return offer;
}

discovery::wire::TSensorDeployDescriptor descriptor() {
  discovery::wire::TSensorDeployDescriptor descriptor;
  descriptor.__set_filename("turtle.so");
  descriptor.__set_className("turtle");
  descriptor.__set_properties({{"rate", "5"}});
  return descriptor;
}

discovery::wire::TLookRequest look() {
  discovery::wire::TLookRequest look;
  look.__set_instance("0a1b");
  look.__set_channel("readings");
  look.__set_look("1");
  look.__set_most(5);
  look.__set_bytes(100);
  return look;
}

discovery::wire::THandedMessage handed() {
  discovery::wire::THandedMessage message;
  message.__set_instance("0a1b");
  message.__set_channel("control");
  message.__set_payload("on");
  message.__set_properties({{"unit", "C"}});
  return message;
}

SeedsOfTarget api_seeds() {
  SeedsOfTarget seeds;
  using Client = master::wire::TMasterAPIServiceClient;
  master::wire::TDeployRequest deployment;
  deployment.__set_gateways({"lab1"});
  deployment.__set_plugin("turtle.so");
  deployment.__set_properties({{"channel.data.deadline_ms", "100"}});
  deployment.__set_metadata({{"site", "lab"}});
  deployment.__set_name("robot");
  deployment.__set_indexes({2, 3});
  master::wire::TInstanceSelection selection;
  selection.__set_instances({"0a1b"});
  selection.__set_waitMs(1);
  master::wire::TDeploymentChange change;
  change.__set_instances({"0a1b"});
  change.__set_properties({{"rate", "6"}});
  change.__set_manager("lab");
  master::wire::TGatewaySelection gateways;
  gateways.__set_gateways({"lab1"});
  master::wire::TUpdateRequest update;
  update.__set_selection(selection);
  update.__set_plugin("turtle.so");
  update.__set_sha256(sha256_of_bytes);
  update.__set_atOnce(1);
  update.__set_settleMs(1);
  auto of_content = deployment;
  of_content.__set_sha256(sha256_of_bytes);
  master::wire::TTopologyRequest topology;
  topology.__set_topology("echo");
  topology.__set_change(master::wire::TTopologyChange::REBALANCE);
  topology.__set_parallelism({{"in", 2}});
  seeds["reads"] = sent<Client>([&](Client& client) {
    client.send_authenticate("token");
    client.send_getStatus();
    client.send_getSites();
    client.send_getSite("lab1");
    client.send_listGateways();
    client.send_listDrivers();
    client.send_listOrders();
    client.send_exportOrders();
    client.send_listTopologies();
    client.send_getHistory({"0a"}, {"lab1"}, 5);
    client.send_readLog("lab1", "0a1b", "", 100);
    client.send_lookAtChannel("lab1", look());
    client.send_handMessage("lab1", handed());
    client.send_readWorkerPage("echo", "w1", "/tap?id=1&component=in");
  });
  seeds["orders"] = sent<Client>([&](Client& client) {
    client.send_deploy(deployment);
    client.send_stop(selection);
    client.send_start(selection);
    client.send_updateMetadata(selection, {{"site", "roof"}, {"note", ""}});
    client.send_changeDeployment(change);
    client.send_drain(gateways);
    client.send_undrain(gateways);
    client.send_undeploy(selection);
  });
  seeds["deploy"] = sent<Client>([&](Client& client) { client.send_deploy(deployment); });
  seeds["change"] = sent<Client>([&](Client& client) { client.send_changeDeployment(change); });
  seeds["plugin"] = sent<Client>([&](Client& client) {
    client.send_offerPlugin(offer<master::wire::TPluginOffer>(), {"lab1", "lab2"});
    client.send_sendPlugin("0", 0, "by");
    client.send_sendPlugin("0", 2, "tes");
    client.send_finishPlugin("0");
    client.send_deploy(of_content);
  });
  seeds["update"] = sent<Client>([&](Client& client) { client.send_update(update); });
  seeds["topology"] = sent<Client>([&](Client& client) { client.send_orderTopology(topology); });
  seeds["original"] = sent<Client>([&](Client& client) {
    client.send_deploySensor({"lab1"}, descriptor());
    client.send_startSensor({"lab1"}, "0a1b");
    client.send_getSensors("lab1");
    client.send_unDeployAllSensor("0a1b");
  });
  return seeds;
}

SeedsOfTarget gateway_seeds() {
  SeedsOfTarget seeds;
  using Client = master::wire::TMasterServiceClient;
  discovery::wire::TBroker broker;
  broker.__set_name("rabbitmq");
  discovery::wire::TSite site;
  site.__set_siteId("java");
  site.__set_host("127.0.0.1");
  site.__set_port(12905);
  site.__set_brokers({broker});
  discovery::wire::TChannel channel;
  channel.__set_name("kinect");
  channel.__set_transport("rabbitmq");
  channel.__set_properties({{"queueName", "kinect"}});
  discovery::wire::TSensor sensor;
  sensor.__set_name("turtle");
  sensor.__set_sensorId("0a1b");
  sensor.__set_siteId("java");
  sensor.__set_channels({channel});
  seeds["life"] = sent<Client>([&](Client& client) {
    client.send_registerSite(site);
    client.send_registerSensor("java", sensor);
    client.send_updateSensor("java", sensor);
    client.send_unRegisterSensor("java", "0a1b");
    client.send_unRegisterSite(site);
  });
  seeds["register"] = sent<Client>([&](Client& client) { client.send_registerSite(site); });
  seeds["sensor"] = sent<Client>([&](Client& client) { client.send_registerSensor("java", sensor); });
  return seeds;
}

discovery::wire::TKnownPlugin known_plugin() {
  discovery::wire::TKnownPlugin plugin;
  plugin.__set_file("turtle.so");
  plugin.__set_sha256(sha256_of_bytes);
  plugin.__set_size(5);
  return plugin;
}

struct AnsweringSite : gateway::wire::TSensorSiteServiceNull {
  void ping(gateway::wire::TPing& answer) override { answer.__set_gateway("lab1"); }
  void getChanges(std::vector<gateway::wire::TStateChange>& answer, const std::string& instance) override {
    gateway::wire::TStateChange change;
    change.__set_instance(instance);
    change.__set_state("active");
    answer = {change, change};
  }
  void readLog(gateway::wire::TLogPart& answer, const std::string&, const std::string&, const std::int32_t) override {
    answer.__set_text("a line\n");
    answer.__set_position("1:9");
  }
  void lookAtChannel(discovery::wire::TChannelLook& answer, const discovery::wire::TLookRequest&) override {
    discovery::wire::TSeenMessage message;
    message.__set_payload(std::string("\0on", 3));
    message.__set_properties({{"unit", "C"}});
    discovery::wire::TChannelState channel;
    channel.__set_name("readings");
    answer.__set_channels({channel});
    answer.__set_messages({message, message});
  }
  void getCarried(std::vector<gateway::wire::TCarried>& answer) override {
    gateway::wire::TCarried carried;
    carried.__set_host("turtle.so");
    carried.__set_sent(7);
    carried.__set_roundTrips({{1048.576, 6}});
    answer = {carried};
  }
  void listPlugins(std::vector<discovery::wire::TKnownPlugin>& answer) override { answer = {known_plugin()}; }
  void offerPlugin(std::string&, const gateway::wire::TPluginOffer&) override {
    gateway::wire::TSiteError error;
    error.__set_reason("no");
    throw error;
  }
};

struct AnsweringMaster : master::wire::TMasterAPIServiceNull {
  void getStatus(master::wire::TMasterStatus& answer) override { answer.__set_leader("lab0:5433"); }
  void getHistory(master::wire::TDriverHistory& answer, const std::vector<std::string>&,
                  const std::vector<std::string>& gateways, const std::int32_t) override {
    master::wire::TDriverChange change;
    change.__set_gateway(gateways.front());
    change.__set_state("failed");
    answer.__set_changes({change});
    answer.__set_silent({{"lab2", "it does not answer"}});
  }
  void listPlugins(master::wire::TGatewayPlugins& answer, const std::vector<std::string>&) override {
    master::wire::TGatewayPlugin plugin;
    plugin.__set_gateway("lab1");
    plugin.__set_plugin(known_plugin());
    answer.__set_plugins({plugin});
  }
};

struct AnsweringPool : topology::wire::TPoolServiceNull {
  void ping(topology::wire::TPoolPing& answer) override { answer.__set_pool("pool1"); }
  void readLog(topology::wire::TWorkerLogPart& answer, const std::string&, const std::int32_t, const std::string&,
               const std::int32_t) override {
    answer.__set_text("a line\n");
    answer.__set_position("1:9");
  }
  void offerLibrary(std::string&, const topology::wire::TLibraryOffer&) override {
    topology::wire::TPoolError error;
    error.__set_reason("no");
    throw error;
  }
  void describeLibrary(topology::wire::TKeptLibrary& answer, const std::string&) override {
    answer.__set_size(5);
    answer.__set_signature(std::string(64, 's'));
  }
  void readLibrary(std::string& answer, const std::string&, const std::int64_t) override { answer = "bytes"; }
};

struct AnsweringNimbus : topology::storm::idl::NimbusNull {
  void getLeader(topology::storm::idl::NimbusSummary& answer) override {
    answer.__set_host("lab1");
    answer.__set_port(6627);
    answer.__set_version("2.8.3");
  }
  void getTopologySummaries(std::vector<topology::storm::idl::TopologySummary>& answer) override {
    topology::storm::idl::TopologySummary topology;
    topology.__set_name("echo");
    topology.__set_sched_status("ok");
    answer = {topology, topology};
  }
  void getTopologyInfoByName(topology::storm::idl::TopologyInfo& answer, const std::string& name) override {
    topology::storm::idl::ExecutorSummary executor;
    executor.__set_component_id("in");
    executor.__set_stats({});
    topology::storm::idl::ErrorInfo error;
    error.__set_error("no\n at line 1");
    error.__set_host("lab1");
    answer.__set_name(name);
    answer.__set_executors({executor});
    answer.__set_errors({{"in", {error, error}}});
  }
  void getTopologyPageInfo(topology::storm::idl::TopologyPageInfo& answer, const std::string& id, const std::string&,
                           const bool) override {
    topology::storm::idl::ComponentAggregateStats stats;
    topology::storm::idl::CommonAggregateStats common;
    common.__set_emitted(7);
    topology::storm::idl::BoltAggregateStats bolt;
    bolt.__set_capacity(0.5);
    topology::storm::idl::SpecificAggregateStats specific;
    specific.__set_bolt(bolt);
    stats.__set_common_stats(common);
    stats.__set_specific_stats(specific);
    answer.__set_id(id);
    answer.__set_id_to_bolt_agg_stats({{"count", stats}});
  }
};

/// The first byte chooses the call that the rest answers (thrift_answers_fuzzer.cc).
SeedsOfTarget answer_seeds() {
  using Site = gateway::wire::TSensorSiteServiceClient;
  using Api = master::wire::TMasterAPIServiceClient;
  const auto of_site = [](char call, const auto& calls) {
    return call + answered<Site, gateway::wire::TSensorSiteServiceProcessor, AnsweringSite>(calls);
  };
  const auto of_master = [](char call, const auto& calls) {
    return call + answered<Api, master::wire::TMasterAPIServiceProcessor, AnsweringMaster>(calls);
  };
  using Pool = topology::wire::TPoolServiceClient;
  const auto of_pool = [](char call, const auto& calls) {
    return call + answered<Pool, topology::wire::TPoolServiceProcessor, AnsweringPool>(calls);
  };
  using Nimbus = topology::storm::idl::NimbusClient;
  const auto of_nimbus = [](char call, const auto& calls) {
    return call + answered<Nimbus, topology::storm::idl::NimbusProcessor, AnsweringNimbus>(calls);
  };
  SeedsOfTarget seeds;
  seeds["nimbus_leader"] = of_nimbus('\xf', [](Nimbus& nimbus) { nimbus.send_getLeader(); });
  seeds["nimbus_list"] = of_nimbus('\x10', [](Nimbus& nimbus) { nimbus.send_getTopologySummaries(); });
  seeds["nimbus_info"] = of_nimbus('\x11', [](Nimbus& nimbus) { nimbus.send_getTopologyInfoByName("echo"); });
  seeds["nimbus_page"] =
      of_nimbus('\x12', [](Nimbus& nimbus) { nimbus.send_getTopologyPageInfo("echo-1", ":all-time", false); });
  seeds["carried"] = of_site('\x13', [](Site& site) { site.send_getCarried(); });
  seeds["ping"] = of_site('\0', [](Site& site) { site.send_ping(); });
  seeds["changes"] = of_site('\1', [](Site& site) { site.send_getChanges("0a1b"); });
  seeds["log"] = of_site('\2', [](Site& site) { site.send_readLog("0a1b", "", 9); });
  seeds["look"] = of_site('\3', [](Site& site) { site.send_lookAtChannel(look()); });
  seeds["plugins"] = of_site('\4', [](Site& site) { site.send_listPlugins(); });
  seeds["error"] = of_site('\5', [](Site& site) { site.send_offerPlugin(offer<gateway::wire::TPluginOffer>()); });
  seeds["authenticated"] = of_site('\6', [](Site& site) { site.send_authenticate("token"); });
  seeds["status"] = of_master('\7', [](Api& api) { api.send_getStatus(); });
  seeds["history"] = of_master('\x8', [](Api& api) { api.send_getHistory({"0a"}, {"lab1"}, 5); });
  seeds["gateways_plugins"] = of_master('\x9', [](Api& api) { api.send_listPlugins({}); });
  seeds["pool_ping"] = of_pool('\xa', [](Pool& pool) { pool.send_ping(); });
  seeds["pool_log"] = of_pool('\xb', [](Pool& pool) { pool.send_readLog("echo", 0, "", 9); });
  seeds["pool_error"] =
      of_pool('\xc', [](Pool& pool) { pool.send_offerLibrary(offer<topology::wire::TLibraryOffer>()); });
  seeds["pool_kept"] = of_pool('\xd', [](Pool& pool) { pool.send_describeLibrary(sha256_of_bytes); });
  seeds["pool_piece"] = of_pool('\xe', [](Pool& pool) { pool.send_readLibrary(sha256_of_bytes, 0); });
  seeds["unknown"] = of_site('\x7', [](Site& site) { site.send_ping(); });
  // A list as long as the field can say, of structs: each may be one byte.
  std::string endless = seeds["changes"];
  const auto list = endless.find(std::string("\x0f\x00\x00\x0c", 4));
  endless.replace(list + 4, 4, "\x7f\xff\xff\xff");
  seeds["endless"] = endless;
  return seeds;
}

SeedsOfTarget site_seeds() {
  SeedsOfTarget seeds;
  using Client = gateway::wire::TSensorSiteServiceClient;
  seeds["original"] = sent<Client>([](Client& client) {
    client.send_hearbeat({});
    client.send_deploySensor(descriptor());
    client.send_startSensor("0a1b");
    client.send_stopSensor("0a1b");
    client.send_unDeploySensor("0a1b");
  });
  seeds["reads"] = sent<Client>([](Client& client) {
    client.send_ping();
    client.send_getChanges("");
    client.send_readLog("0a1b", "1:2", 100);
    client.send_lookAtChannel(look());
    client.send_handMessage(handed());
  });
  seeds["plugin"] = sent<Client>([](Client& client) {
    client.send_offerPlugin(offer<gateway::wire::TPluginOffer>());
    client.send_sendPlugin("0", 0, "by");
    client.send_sendPlugin("0", 2, "tes");
    client.send_finishPlugin("0");
    client.send_offerPlugin(offer<gateway::wire::TPluginOffer>());
  });
  seeds["plugins"] = sent<Client>([](Client& client) {
    client.send_offerPlugin(offer<gateway::wire::TPluginOffer>());
    client.send_offerPlugin(offer<gateway::wire::TPluginOffer>());
    client.send_sendPlugin("1", 0, "bytes");
    client.send_finishPlugin("0");
    client.send_finishPlugin("1");
  });
  return seeds;
}

SeedsOfTarget pool_seeds() {
  SeedsOfTarget seeds;
  using Client = topology::wire::TPoolServiceClient;
  const auto library = offer<topology::wire::TLibraryOffer>();
  seeds["reads"] = sent<Client>([](Client& client) {
    client.send_authenticate("token");
    client.send_ping();
    client.send_readLog("echo", 0, "", 100);
    client.send_readLog("echo", 0, "1:2", 100);
    client.send_readLog("../echo", -1, "1:2", -1);
  });
  seeds["library"] = sent<Client>([&](Client& client) {
    client.send_offerLibrary(library);
    client.send_sendLibrary("0", 0, "by");
    client.send_sendLibrary("0", 2, "tes");
    client.send_finishLibrary("0");
    client.send_offerLibrary(library);
    client.send_describeLibrary(sha256_of_bytes);
    client.send_readLibrary(sha256_of_bytes, 2);
    client.send_readLibrary(sha256_of_bytes, 6);
    client.send_readLibrary(sha256_of_bytes, -1);
    client.send_readLibrary(sha256_of_bytes, std::int64_t{1} << 40);
  });
  seeds["libraries"] = sent<Client>([&](Client& client) {
    client.send_offerLibrary(library);
    client.send_offerLibrary(library);
    client.send_sendLibrary("1", 0, "bytes");
    client.send_finishLibrary("0");
    client.send_finishLibrary("1");
  });
  return seeds;
}

SeedsOfTarget manifest_seeds() {
  SeedsOfTarget seeds;
  seeds["empty"] = "fleet: lab\ndeployments: {}\n";
  seeds["documents without end"] = ", fleet: lab\n";
  seeds["aliases of aliases"] = "a: &a [x, x]\nb: &b [*a, *a]\nfleet: [*b, *b]\n";
  seeds["whole"] =
      "fleet: lab\n"
      "deployments:\n"
      "  meter:\n"
      "    plugin: meter.so\n"
      "    driver: thermometer\n"
      "    gateways: [lab1, lab2]\n"
      "    count: 2\n"
      "    state: inactive\n"
      "    properties: {rate: 5, text: \"a: b\"}\n"
      "    metadata: {site: lab}\n"
      "    channels:\n"
      "      data: {when_full: spool, spool_bytes: 65536, spool_fsync: never, spool_full: block, priority: 7}\n"
      "      control: {keep_last: 1, deadline_ms: 100, durable: true, shared: false, broker: b, interop: java}\n"
      "  all: &all {plugin: a.so, gateways: all}\n"
      "  again: *all\n";
  return seeds;
}

}  // namespace

void add_control_plane_seeds(Seeds& seeds) {
  seeds["master_api"] = api_seeds();
  seeds["master_gateways"] = gateway_seeds();
  seeds["gateway_site"] = site_seeds();
  seeds["pool_service"] = pool_seeds();
  seeds["thrift_answers"] = answer_seeds();
  seeds["manifest"] = manifest_seeds();
}

}  // namespace iotcloud::fuzz
