// What anybody may answer to a call of ours: a false gateway or pool to a master, a false master to the command line, a
// false Nimbus to iotcloud-storm.
// The first byte chooses the call, the rest are the bytes of the connection.
#include <array>
#include <functional>
#include <string>

#include <thrift/Thrift.h>

#include "iotcloud/config/error.h"
#include "iotcloud/discovery/channel_look.h"
#include "iotcloud/discovery/description/wire.h"
#include "iotcloud/gateway/TSensorSiteService.h"
#include "iotcloud/master/TMasterAPIService.h"
#include "iotcloud/master/orders/answers.h"
#include "iotcloud/rpc/thrift_client.h"
#include "iotcloud/tests/fuzz/answering_server.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/topology/pool/TPoolService.h"
#include "iotcloud/topology/storm/Nimbus.h"

using namespace iotcloud;
using Site = gateway::wire::TSensorSiteServiceClient;
using Api = master::wire::TMasterAPIServiceClient;
using Workers = topology::wire::TPoolServiceClient;
using Nimbus = topology::storm::idl::NimbusClient;

namespace {

using Protocol = std::shared_ptr<apache::thrift::protocol::TProtocol>;

/// A call, and the reading of its answer. The order is part of the corpus: new ones go to the end.
const std::array calls = {
    std::function([](const Protocol& to) {
      gateway::wire::TPing ping;
      Site(to).ping(ping);
    }),
    std::function([](const Protocol& to) {
      std::vector<gateway::wire::TStateChange> changes;
      Site(to).getChanges(changes, "0a1b");
    }),
    std::function([](const Protocol& to) {
      gateway::wire::TLogPart part;
      Site(to).readLog(part, "0a1b", "1:2", 100);
    }),
    std::function([](const Protocol& to) {
      discovery::wire::TChannelLook look;
      Site(to).lookAtChannel(look, {});
      discovery::as_own<discovery::ChannelLook>(look);
    }),
    std::function([](const Protocol& to) {
      std::vector<discovery::wire::TKnownPlugin> plugins;
      Site(to).listPlugins(plugins);
    }),
    std::function([](const Protocol& to) {
      std::string upload;
      Site(to).offerPlugin(upload, {});
      Site(to).finishPlugin(upload);
    }),
    std::function([](const Protocol& to) {
      discovery::wire::TResponse response;
      Site(to).authenticate(response, "lab.00");
    }),
    std::function([](const Protocol& to) {
      master::wire::TMasterStatus status;
      Api(to).getStatus(status);
      discovery::as_own<master::MasterStatus>(status);
    }),
    std::function([](const Protocol& to) {
      master::wire::TDriverHistory history;
      Api(to).getHistory(history, {"0a"}, {"lab1"}, 5);
      discovery::as_own<master::DriverHistory>(history);
    }),
    std::function([](const Protocol& to) {
      master::wire::TGatewayPlugins plugins;
      Api(to).listPlugins(plugins, {});
      discovery::as_own<master::GatewayPlugins>(plugins);
    }),
    std::function([](const Protocol& to) {
      topology::wire::TPoolPing ping;
      Workers(to).ping(ping);
    }),
    std::function([](const Protocol& to) {
      topology::wire::TWorkerLogPart part;
      Workers(to).readLog(part, "echo", 0, "1:2", 100);
    }),
    std::function([](const Protocol& to) {
      std::string upload;
      Workers(to).offerLibrary(upload, {});
    }),
    std::function([](const Protocol& to) {
      topology::wire::TKeptLibrary kept;
      Workers(to).describeLibrary(kept, "00");
    }),
    std::function([](const Protocol& to) {
      std::string piece;
      Workers(to).readLibrary(piece, "00", 0);
    }),
    std::function([](const Protocol& to) {
      topology::storm::idl::NimbusSummary leader;
      Nimbus(to).getLeader(leader);
    }),
    std::function([](const Protocol& to) {
      std::vector<topology::storm::idl::TopologySummary> topologies;
      Nimbus(to).getTopologySummaries(topologies);
    }),
    std::function([](const Protocol& to) {
      topology::storm::idl::TopologyInfo info;
      Nimbus(to).getTopologyInfoByName(info, "echo");
    }),
    std::function([](const Protocol& to) {
      topology::storm::idl::TopologyPageInfo page;
      Nimbus(to).getTopologyPageInfo(page, "echo-1", ":all-time", false);
    }),
    std::function([](const Protocol& to) {
      std::vector<gateway::wire::TCarried> carried;
      Site(to).getCarried(carried);
    }),
};

}  // namespace

IOTCLOUD_FUZZ_TARGET(thrift_answers, 1'500) {
  if (size == 0) return;
  auto& server = fuzz::answering_server();
  server.answer_with(std::string(fuzz::text(data + 1, size - 1)));
  rpc::ThriftClientOptions to;
  to.host = "127.0.0.1";
  to.port = server.port();
  try {
    calls[*data % calls.size()](rpc::ThriftClient(to).protocol());
  } catch (const apache::thrift::TException&) {  // NOLINT(bugprone-empty-catch): callers say what went wrong
  } catch (const config::Error&) {               // NOLINT(bugprone-empty-catch): the same
  }
}
