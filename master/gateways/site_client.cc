#include <algorithm>
#include <fstream>

#include <fmt/format.h>
#include <thrift/TApplicationException.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/wire.h>
#include <iotcloud/master/gateways/site_client.h>
#include <iotcloud/rpc/thrift_client.h>

namespace iotcloud::master {

using apache::thrift::TApplicationException;
using discovery::wire::TResponse;
using discovery::wire::TResponseState;
using gateway::wire::TSensorSiteServiceClient;

namespace {

constexpr std::chrono::milliseconds connect_limit{2'000};
/// In an answer of a gateway: about twice as many as those of ours have.
constexpr int most_answer_bytes = 8 << 20;
/// The same where it has messages of a channel.
constexpr int most_look_bytes = most_answer_bytes + 2 * discovery::most_seen_messages * discovery::most_seen_bytes;

/// Makes a client on a new connection. \throws TException, config::Error
/// \param gateway with TLS: the id that the certificate there must name, before it gets the token; empty: none
TSensorSiteServiceClient connect(const SiteAddress& site, const discovery::GatewayId& gateway,
                                 std::chrono::milliseconds limit, int most_bytes = most_answer_bytes) {
  rpc::ThriftClientOptions options;
  options.host = site.host;
  options.port = site.port;
  options.tls = site.tls;
  if (!gateway.empty()) options.daemon = security::NamedDaemon{security::NamedDaemon::Kind::gateway, gateway.str()};
  options.answer_limit = std::max(limit, std::chrono::milliseconds{1});
  options.connect_limit = std::min(options.answer_limit, connect_limit);
  options.most_bytes = most_bytes;
  TSensorSiteServiceClient client(rpc::ThriftClient(options).protocol());
  if (site.token_file.empty() || site.tls.empty()) return client;
  TResponse answer;
  client.authenticate(answer, token_in(site.token_file));
  if (answer.state != TResponseState::SUCCESS) throw config::Error(answer.statusMessage);
  return client;
}

/// Asks the gateway with this id and no other. All errors become config::Error.
template <typename Question>
void put(const SiteAddress& site, const discovery::GatewayId& gateway, std::chrono::milliseconds limit,
         Question&& question, int most_bytes = most_answer_bytes) {
  bool known = false;  // it has answered a question of ours
  try {
    auto client = connect(site, gateway, limit, most_bytes);
    gateway::wire::TPing answer;
    client.ping(answer);
    if (answer.gateway != gateway) {
      throw config::Error(fmt::format(
          "at {}:{} another gateway answers ({}); a gateway whose Thrift service is on loopback can be asked "
          "by a master of its own machine only: give it an address, TLS and tokens (config/gateway.yaml)",
          site.host, site.port, answer.gateway));
    }
    known = true;
    question(client);
  } catch (const gateway::wire::TSiteError& e) {
    throw config::Error(e.reason);
  } catch (const TApplicationException& e) {
    if (e.getType() != TApplicationException::UNKNOWN_METHOD) throw config::Error(e.what());
    // ping() is older than all other questions.
    throw config::Error(
        known ? fmt::format("gateway {} runs an older version, which does not know this question: update it", gateway)
              : fmt::format("gateway {} is of the original system, which tells neither history nor logs, lists no "
                            "plugins, shows no channels and takes no plugin files",
                            gateway));
  } catch (const apache::thrift::TException& e) {
    if (rpc::ThriftClient::is_too_large(e)) {
      throw config::Error(
          fmt::format("gateway {} at {}:{} has an answer of more than {} MB, which is not read: look at "
                      "what runs there, because gateways give shorter ones",
                      gateway, site.host, site.port, most_bytes >> 20));
    }
    throw config::Error(
        fmt::format("gateway {} at {}:{} does not answer: {}", gateway, site.host, site.port, e.what()));
  }
}

/// Calls a method that answers with what is known of a channel.
template <typename Asked>
discovery::ChannelLook ask_of_channel(
    const SiteAddress& site, const discovery::GatewayId& gateway, std::chrono::milliseconds limit,
    void (TSensorSiteServiceClient::*method)(discovery::wire::TChannelLook&, const Asked&), const Asked& asked) {
  discovery::wire::TChannelLook look;
  put(
      site, gateway, limit, [&](auto& client) { (client.*method)(look, asked); }, most_look_bytes);
  return discovery::as_own<discovery::ChannelLook>(look);
}

template <typename Call>
SiteAnswer ask(const SiteAddress& site, std::chrono::milliseconds limit, Call&& call) {
  bool connected = false;
  try {
    auto client = connect(site, {}, limit);
    connected = true;
    TResponse response;
    call(client, response);
    return {response.state == TResponseState::SUCCESS ? OrderOutcome::done : OrderOutcome::failed,
            response.statusMessage};
  } catch (const std::exception& e) {
    // Once connected, the gateway may have received the call although no answer came.
    return {connected ? OrderOutcome::unknown : OrderOutcome::failed,
            fmt::format("{}:{} does not answer: {}", site.host, site.port, e.what())};
  }
}

}  // namespace

std::string token_in(const std::string& file) {
  std::ifstream in(file);
  std::string line;
  if (!std::getline(in, line) || line.empty())
    throw config::Error(fmt::format("cannot read a token from {}: its first line must be one", file));
  return line;
}

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

SiteAnswer site_change(const SiteAddress& site, const discovery::InstanceId& instance, InstanceAction action,
                       std::chrono::milliseconds limit) {
  return ask(site, limit, [&](auto& client, auto& response) {
    switch (action) {
      case InstanceAction::undeploy:
        return client.unDeploySensor(response, instance);
      case InstanceAction::start:
        return client.startSensor(response, instance);
      case InstanceAction::stop:
        return client.stopSensor(response, instance);
    }
  });
}

std::vector<DriverChange> site_changes(const SiteAddress& site, const discovery::GatewayId& gateway,
                                       const discovery::InstanceId& instance, std::chrono::milliseconds limit) {
  std::vector<gateway::wire::TStateChange> told;
  put(site, gateway, limit, [&](auto& client) { client.getChanges(told, instance); });
  std::vector<DriverChange> changes;
  changes.reserve(told.size());
  for (auto& change : told) {
    changes.push_back({gateway, discovery::InstanceId(std::move(change.instance)),
                       discovery::DriverName(std::move(change.driver)), std::move(change.state),
                       std::move(change.reason), change.timeMs});
  }
  return changes;
}

std::vector<GatewayPlugin> site_plugins(const SiteAddress& site, const discovery::GatewayId& gateway,
                                        std::chrono::milliseconds limit) {
  std::vector<discovery::wire::TKnownPlugin> told;
  put(site, gateway, limit, [&](auto& client) { client.listPlugins(told); });
  std::vector<GatewayPlugin> plugins;
  plugins.reserve(told.size());
  for (const auto& plugin : told) plugins.push_back({gateway, discovery::as_own<discovery::KnownPlugin>(plugin)});
  return plugins;
}

std::vector<discovery::CarriedMessages> site_carried(const SiteAddress& site, const discovery::GatewayId& gateway,
                                                     std::chrono::milliseconds limit) {
  std::vector<gateway::wire::TCarried> told;
  put(site, gateway, limit, [&](auto& client) { client.getCarried(told); });
  std::vector<discovery::CarriedMessages> all;
  all.reserve(told.size());
  for (const auto& one : told) {
    auto& carried = all.emplace_back();
    carried.host = one.host;
    constexpr std::int64_t oldest_ms = 3'600'000;
    const auto count_of = [](std::int64_t count) {
      return static_cast<std::uint64_t>(std::max<std::int64_t>(count, 0));
    };
    carried.age = std::chrono::milliseconds(std::clamp<std::int64_t>(one.ageMs, 0, oldest_ms));
    carried.sent = count_of(one.sent);
    carried.received = count_of(one.received);
    for (const auto& [end_us, count] : one.roundTrips) carried.round_trips.emplace(end_us, count_of(count));
  }
  return all;
}

LogPart site_read_log(const SiteAddress& site, const discovery::GatewayId& gateway,
                      const discovery::InstanceId& instance, const std::string& position, std::int32_t most_bytes,
                      std::chrono::milliseconds limit) {
  gateway::wire::TLogPart part;
  put(site, gateway, limit, [&](auto& client) { client.readLog(part, instance, position, most_bytes); });
  return discovery::as_own<LogPart>(part);
}

discovery::ChannelLook site_look_at_channel(const SiteAddress& site, const discovery::GatewayId& gateway,
                                            const discovery::LookRequest& request, std::chrono::milliseconds limit) {
  return ask_of_channel(site, gateway, limit, &TSensorSiteServiceClient::lookAtChannel,
                        discovery::as_wire<discovery::wire::TLookRequest>(request));
}

discovery::ChannelLook site_hand_message(const SiteAddress& site, const discovery::GatewayId& gateway,
                                         const discovery::HandedMessage& message, std::chrono::milliseconds limit) {
  return ask_of_channel(site, gateway, limit, &TSensorSiteServiceClient::handMessage,
                        discovery::as_wire<discovery::wire::THandedMessage>(message));
}

std::string site_offer_plugin(const SiteAddress& site, const discovery::GatewayId& gateway, const PluginOffer& offer,
                              std::chrono::milliseconds limit) {
  const auto wire_offer = discovery::as_wire<gateway::wire::TPluginOffer>(offer);
  std::string upload;
  put(site, gateway, limit, [&](auto& client) { client.offerPlugin(upload, wire_offer); });
  return upload;
}

void site_send_plugin(const SiteAddress& site, const discovery::GatewayId& gateway, const std::string& upload,
                      std::int64_t offset, const std::string& bytes, std::chrono::milliseconds limit) {
  put(site, gateway, limit, [&](auto& client) { client.sendPlugin(upload, offset, bytes); });
}

void site_finish_plugin(const SiteAddress& site, const discovery::GatewayId& gateway, const std::string& upload,
                        std::chrono::milliseconds limit) {
  put(site, gateway, limit, [&](auto& client) { client.finishPlugin(upload); });
}

}  // namespace iotcloud::master
