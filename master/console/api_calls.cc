#include <map>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>
#include <thrift/TApplicationException.h>
#include <thrift/TProcessor.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/description/wire.h>
#include <iotcloud/discovery/wire_records.h>
#include <iotcloud/master/api/wire.h>
#include <iotcloud/master/console/answers.h>
#include <iotcloud/master/console/api_calls.h>

namespace iotcloud::master {

namespace {

using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TMemoryBuffer;
using Client = wire::TMasterAPIServiceClient;
using Json = nlohmann::ordered_json;

constexpr std::int32_t most_log_bytes = 65'536;

/// A client of the service in this process: a call is written, answered, and read.
class OwnClient {
 public:
  OwnClient(const rpc::ThriftService& api, const ConsoleCaller& caller)
      : peer_(std::make_shared<rpc::ThriftPeer>(caller.address, caller.certificate)),
        question_(std::make_shared<TBinaryProtocol>(std::make_shared<TMemoryBuffer>())),
        answer_(std::make_shared<TBinaryProtocol>(std::make_shared<TMemoryBuffer>())),
        client_(answer_, question_) {
    peer_->set_user(caller.user);
    if (caller.holder) peer_->vouch(*caller.holder);
    processor_ = api(peer_);
  }

  template <typename Answer, typename... SendParameters, typename... Arguments>
  Answer ask(void (Client::*send)(SendParameters...), void (Client::*receive)(Answer&), const Arguments&... arguments) {
    Answer answer;
    try {
      (client_.*send)(arguments...);
      processor_->process(question_, answer_, nullptr);
      (client_.*receive)(answer);
    } catch (const wire::TMasterError& error) {
      throw config::Error(error.reason);
    } catch (const apache::thrift::TException& error) {
      throw config::Error(error.what());
    }
    return answer;
  }

 private:
  const std::shared_ptr<rpc::ThriftPeer> peer_;
  const std::shared_ptr<TBinaryProtocol> question_, answer_;
  Client client_;
  std::shared_ptr<apache::thrift::TProcessor> processor_;
};

std::string order(OwnClient& client, const nlohmann::json& given) {
  return answer_of(from_wire(client.ask(&Client::send_giveOrder, &Client::recv_giveOrder, text_of(given, "order"),
                                        given.value("with", nlohmann::json::object()).dump())));
}

std::string order_topology(OwnClient& client, const nlohmann::json& given) {
  return answer_of(from_wire(client.ask(&Client::send_orderTopology, &Client::recv_orderTopology,
                                        discovery::as_wire<wire::TTopologyRequest>(read_topology_order(given)))));
}

std::string history(OwnClient& client, const nlohmann::json& given) {
  return answer_of(discovery::as_own<DriverHistory>(
      client.ask(&Client::send_getHistory, &Client::recv_getHistory, texts_of(given, "instances"),
                 texts_of(given, "gateways"), given.value("most", std::int32_t{1000}))));
}

std::string log(OwnClient& client, const nlohmann::json& given) {
  return discovery::to_text(discovery::to_json<Json>(
      discovery::as_own<LogPart>(client.ask(&Client::send_readLog, &Client::recv_readLog, text_of(given, "gateway"),
                                            text_of(given, "instance"), text_of(given, "position"), most_log_bytes))));
}

std::string look(OwnClient& client, const nlohmann::json& given) {
  const auto request = discovery::from_json<discovery::LookRequest>(given, "a look");
  return answer_of(discovery::as_own<discovery::ChannelLook>(
      client.ask(&Client::send_lookAtChannel, &Client::recv_lookAtChannel, text_of(given, "gateway"),
                 discovery::as_wire<discovery::wire::TLookRequest>(request))));
}

std::string order_of(OwnClient& client, const nlohmann::json& given) {
  const auto instance = text_of(given, "instance"), gateway = text_of(given, "gateway");
  for (auto& each : client.ask(&Client::send_listOrders, &Client::recv_listOrders)) {
    const auto own = discovery::as_own<ListedOrder>(std::move(each));
    if (own.order.instance == instance && own.gateway == gateway)
      return discovery::to_text(discovery::to_json<Json>(own));
  }
  throw config::Error("there is no order for this instance");
}

std::string plugins(OwnClient& client, const nlohmann::json& given) {
  return answer_of(discovery::as_own<GatewayPlugins>(
      client.ask(&Client::send_listPlugins, &Client::recv_listPlugins, texts_of(given, "gateways"))));
}

std::string topology_history(OwnClient& client, const nlohmann::json& given) {
  Json events = Json::array();
  for (auto& event :
       client.ask(&Client::send_getTopologyHistory, &Client::recv_getTopologyHistory, text_of(given, "topology"))) {
    events.push_back(discovery::to_json<Json>(discovery::as_own<discovery::TopologyEvent>(std::move(event))));
  }
  return discovery::to_text(events);
}

std::string worker_page(OwnClient& client, const nlohmann::json& given) {
  const auto page = client.ask(&Client::send_readWorkerPage, &Client::recv_readWorkerPage, text_of(given, "topology"),
                               text_of(given, "worker"), text_of(given, "target"));
  return discovery::to_text(discovery::parse_json_as<Json>(page, "a worker's page", page.size()));
}

std::string status(OwnClient& client, const nlohmann::json& /*given*/) {
  return discovery::to_text(discovery::to_json<Json>(
      discovery::as_own<MasterStatus>(client.ask(&Client::send_getStatus, &Client::recv_getStatus))));
}

class ApiCalls final : public ConsoleCalls {
 public:
  explicit ApiCalls(rpc::ThriftService api) : api_(std::move(api)) {}

  std::string authenticate(const ConsoleCaller& caller, const std::string& token) override {
    OwnClient client(api_, caller);
    const auto answer = client.ask(&Client::send_authenticate, &Client::recv_authenticate, token);
    return answer.state == discovery::wire::TResponseState::SUCCESS ? "" : answer.statusMessage;
  }

  std::string call(const ConsoleCaller& caller, const std::string& call, const std::string& json) override {
    static const std::map<std::string, std::string (*)(OwnClient&, const nlohmann::json&)> calls{
        {"order", order},        {"topology", order_topology},
        {"history", history},    {"log", log},
        {"look", look},          {"order_of", order_of},
        {"plugins", plugins},    {"status", status},
        {"worker", worker_page}, {"topology_history", topology_history}};
    const auto found = calls.find(call);
    if (found == calls.end()) throw config::Error("the console has no call \"" + call + "\"");
    const auto given = read_arguments(call, json);
    OwnClient client(api_, caller);
    try {
      return found->second(client, given);
    } catch (const nlohmann::json::exception& error) {
      throw config::Error("the call " + call + ": " + error.what());
    }
  }

 private:
  const rpc::ThriftService api_;
};

}  // namespace

std::unique_ptr<ConsoleCalls> calls_of_api(rpc::ThriftService api) {
  return std::make_unique<ApiCalls>(std::move(api));
}

}  // namespace iotcloud::master
