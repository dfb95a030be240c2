#include <algorithm>
#include <fstream>

#include <fmt/format.h>
#include <thrift/TApplicationException.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/thrift/thrift_client.h>
#include <iotcloud/master/originals/site_client.h>

namespace iotcloud::master {

using apache::thrift::TApplicationException;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;
using gateway::wire::TSensorSiteServiceClient;

namespace {

constexpr std::chrono::milliseconds connect_limit{2'000};

std::string first_line(const std::string& file) {
  std::ifstream in(file);
  std::string line;
  if (!std::getline(in, line) || line.empty())
    throw config::Error(fmt::format("cannot read a token from {}: its first line must be one", file));
  return line;
}

/// A client on a connection of its own. \throws TException, config::Error
TSensorSiteServiceClient connect(const SiteAddress& site, std::chrono::milliseconds limit) {
  config::ThriftClientOptions options;
  options.host = site.host;
  options.port = site.port;
  options.tls = site.tls;
  options.answer_limit = std::max(limit, std::chrono::milliseconds{1});
  options.connect_limit = std::min(options.answer_limit, connect_limit);
  TSensorSiteServiceClient client(config::ThriftClient(options).protocol());
  if (site.token_file.empty()) return client;
  TResponse answer;
  client.authenticate(answer, first_line(site.token_file));
  if (answer.state != TResponseState::SUCCESS) throw config::Error(answer.statusMessage);
  return client;
}

/// A question to this gateway and no other; errors become one kind.
template <typename Question>
void put(const SiteAddress& site, const std::string& gateway, std::chrono::milliseconds limit, Question&& question) {
  try {
    auto client = connect(site, limit);
    gateway::wire::TPing answer;
    client.ping(answer);
    if (answer.gateway != gateway) {
      throw config::Error(fmt::format(
          "at {}:{} another gateway answers ({}); a gateway whose Thrift service is on loopback can be asked "
          "by a master of its own machine only: give it an address, TLS and tokens (config/gateway.yaml)",
          site.host, site.port, answer.gateway));
    }
    question(client);
  } catch (const gateway::wire::TSiteError& e) {
    throw config::Error(e.reason);
  } catch (const TApplicationException& e) {
    if (e.getType() != TApplicationException::UNKNOWN_METHOD) throw config::Error(e.what());
    throw config::Error(
        fmt::format("gateway {} is of the original system, which tells neither history nor logs and takes no "
                    "plugin files",
                    gateway));
  } catch (const apache::thrift::TException& e) {
    throw config::Error(
        fmt::format("gateway {} at {}:{} does not answer: {}", gateway, site.host, site.port, e.what()));
  }
}

template <typename Call>
SiteAnswer ask(const SiteAddress& site, std::chrono::milliseconds limit, Call&& call) {
  bool connected = false;
  try {
    auto client = connect(site, limit);
    connected = true;
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

std::vector<DriverChange> site_changes(const SiteAddress& site, const std::string& gateway, const std::string& instance,
                                       std::chrono::milliseconds limit) {
  std::vector<gateway::wire::TStateChange> told;
  put(site, gateway, limit, [&](auto& client) { client.getChanges(told, instance); });
  std::vector<DriverChange> changes;
  for (auto& change : told) {
    changes.push_back({gateway, std::move(change.instance), std::move(change.driver), std::move(change.state),
                       std::move(change.reason), change.timeMs});
  }
  return changes;
}

LogPart site_read_log(const SiteAddress& site, const std::string& gateway, const std::string& instance,
                      const std::string& position, std::int32_t most_bytes, std::chrono::milliseconds limit) {
  gateway::wire::TLogPart part;
  put(site, gateway, limit, [&](auto& client) { client.readLog(part, instance, position, most_bytes); });
  return {std::move(part.text), std::move(part.position)};
}

std::string site_offer_plugin(const SiteAddress& site, const std::string& gateway, const PluginOffer& offer,
                              std::chrono::milliseconds limit) {
  gateway::wire::TPluginOffer wire_offer;
  wire_offer.__set_plugin(offer.plugin);
  wire_offer.__set_sha256(offer.sha256);
  wire_offer.__set_size(offer.size);
  wire_offer.__set_signature(offer.signature);
  std::string upload;
  put(site, gateway, limit, [&](auto& client) { client.offerPlugin(upload, wire_offer); });
  return upload;
}

void site_send_plugin(const SiteAddress& site, const std::string& gateway, const std::string& upload,
                      std::int64_t offset, const std::string& bytes, std::chrono::milliseconds limit) {
  put(site, gateway, limit, [&](auto& client) { client.sendPlugin(upload, offset, bytes); });
}

void site_finish_plugin(const SiteAddress& site, const std::string& gateway, const std::string& upload,
                        std::chrono::milliseconds limit) {
  put(site, gateway, limit, [&](auto& client) { client.finishPlugin(upload); });
}

}  // namespace iotcloud::master
