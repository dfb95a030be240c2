#include <algorithm>
#include <memory>

#include <fmt/format.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TSocket.h>
#include <thrift/transport/TTransportException.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/master/originals/site_client.h>

namespace iotcloud::master {

using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TFramedTransport;
using apache::thrift::transport::TSocket;
using apache::thrift::transport::TTransportException;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;
using gateway::wire::TSensorSiteServiceClient;

namespace {

constexpr std::chrono::milliseconds connect_limit{2'000};

template <typename Call>
SiteAnswer ask(const SiteAddress& site, std::chrono::milliseconds limit, Call&& call) {
  bool connected = false;
  try {
    auto socket = std::make_shared<TSocket>(site.host, site.port);
    const int limit_ms = static_cast<int>(std::max(limit, std::chrono::milliseconds{1}).count());
    socket->setConnTimeout(static_cast<int>(std::min(limit, connect_limit).count()));
    socket->setRecvTimeout(limit_ms);
    socket->setSendTimeout(limit_ms);
    auto transport = std::make_shared<TFramedTransport>(socket);
    transport->open();
    connected = true;
    TSensorSiteServiceClient client(std::make_shared<TBinaryProtocol>(transport));
    TResponse response;
    call(client, response);
    return {response.state == TResponseState::SUCCESS ? Outcome::done : Outcome::failed, response.statusMessage};
  } catch (const std::exception& e) {
    // What was sent may have been heard, whatever became of the answer.
    return {connected ? Outcome::unknown : Outcome::failed,
            fmt::format("{}:{} does not answer: {}", site.host, site.port, e.what())};
  }
}

}  // namespace

SiteAnswer site_heartbeat(const SiteAddress& site, std::chrono::milliseconds limit) {
  return ask(site, limit, [](auto& client, auto& response) {
    discovery::wire::THeartBeatRequest request;
    request.__set_sensors(0);
    discovery::wire::THeartBeatResponse heartbeat;
    client.hearbeat(heartbeat, request);
    response.__set_state(TResponseState::SUCCESS);
  });
}

SiteAnswer site_deploy(const SiteAddress& site, const DeployRequest& request, std::chrono::milliseconds limit) {
  return ask(site, limit, [&](auto& client, auto& response) {
    discovery::wire::TSensorDeployDescriptor descriptor;
    descriptor.__set_filename(request.plugin);
    descriptor.__set_className(request.driver);
    descriptor.__set_properties(request.properties);
    client.deploySensor(response, descriptor);
  });
}

SiteAnswer site_change(const SiteAddress& site, const std::string& instance, Change change,
                       std::chrono::milliseconds limit) {
  return ask(site, limit, [&](auto& client, auto& response) {
    switch (change) {
      case Change::undeploy:
        return client.unDeploySensor(response, instance);
      case Change::start:
        return client.startSensor(response, instance);
      case Change::stop:
        return client.stopSensor(response, instance);
    }
  });
}

}  // namespace iotcloud::master
