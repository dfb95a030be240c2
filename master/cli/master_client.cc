#include <algorithm>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <thrift/TApplicationException.h>
#include <thrift/transport/TTransportException.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/master/api/wire.h>
#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/rpc/listen_settings.h>
#include <iotcloud/rpc/thrift_client.h>

namespace iotcloud::master::cli {

using apache::thrift::TApplicationException;
using apache::thrift::TException;
using apache::thrift::transport::TTransportException;
using std::chrono::milliseconds;
using Client = wire::TMasterAPIServiceClient;
using discovery::as_own;
using discovery::as_wire;

namespace {

constexpr milliseconds connect_limit{3'000};
constexpr milliseconds read_limit{30'000};
/// Time limit of the first answer on a connection when there is another master to ask. A master that waits for its
/// registry takes three seconds.
constexpr milliseconds first_answer_limit{5'000};
/// How much longer than the requested wait a master may take to answer an order.
constexpr milliseconds order_margin{30'000};
/// The longest that a master may wait by itself when the order does not say how long.
constexpr milliseconds longest_own_wait{600'000};
constexpr milliseconds election_pause{200};

std::vector<std::string> texts(const std::vector<discovery::GatewayId>& ids) {
  return {ids.begin(), ids.end()};
}

discovery::ChannelLook without_problem(discovery::ChannelLook look) {
  if (!look.problem.empty()) throw RequestFailed(look.problem);
  return look;
}

rpc::HostAndPort split(const std::string& address) {
  try {
    return rpc::split_address(address);
  } catch (const config::Error&) {
    throw std::invalid_argument(
        fmt::format("\"{}\" is no address of a master: give HOST:PORT, for example 127.0.0.1:12904", address));
  }
}

/// Why a token must not go to this address: without TLS everybody on the way reads it. Empty if it may.
std::string open_way(const MasterAccess& access, const std::string& address) {
  if (access.token.empty() || !access.tls.empty() || config::is_loopback(split(address).host)) return "";
  return fmt::format(
      "the master {} is not on this machine, and without TLS everybody on the way there could read the token: give "
      "--ca, --certificate and --key, or the address of a tunnel on 127.0.0.1",
      address);
}

}  // namespace

struct MasterClient::Impl {
  std::vector<std::string> addresses;
  MasterAccess access;
  milliseconds election_patience{};
  std::string address;  ///< of the connection, or of the last one if that is broken
  std::unique_ptr<rpc::ThriftClient> connection;
  std::unique_ptr<Client> client;

  /// Says what went wrong, and which options may be missing.
  std::string text_of(const TException& e) const {
    const auto* transport = dynamic_cast<const TTransportException*>(&e);
    const bool no_tls = access.tls.empty() && transport != nullptr &&
                        (transport->getType() == TTransportException::END_OF_FILE ||
                         transport->getType() == TTransportException::CORRUPTED_DATA);
    return no_tls ? fmt::format("{} (does it ask for TLS? --ca, --certificate and --key)", e.what()) : e.what();
  }

  /// \throws TException when there is no master at this address; RequestFailed when it must not see the token.
  void connect(const std::string& to) {
    client.reset();
    if (const auto why = open_way(access, to); !why.empty()) throw RequestFailed(why);
    const auto [host, port] = split(to);
    rpc::ThriftClientOptions options;
    options.host = host;
    options.port = port;
    options.tls = access.tls;
    options.connect_limit = connect_limit;
    options.answer_limit = addresses.size() > 1 ? first_answer_limit : read_limit;
    auto fresh = std::make_unique<rpc::ThriftClient>(options);
    auto asking = std::make_unique<Client>(fresh->protocol());
    open(*asking, to);
    fresh->set_answer_limit(read_limit);
    connection = std::move(fresh);
    client = std::move(asking);
    address = to;
  }

  /// Makes one call, because a master that hangs still accepts connections: only an answer shows that it works.
  void open(Client& fresh, const std::string& to) const {
    if (access.token.empty()) {
      try {
        wire::TMasterStatus ignored;
        fresh.getStatus(ignored);
      } catch (const wire::TMasterError&) {
        // An error is an answer too.
      }
      return;
    }
    discovery::wire::TResponse answer;
    fresh.authenticate(answer, access.token);
    if (answer.state != discovery::wire::TResponseState::SUCCESS)
      throw RequestFailed(fmt::format("master {}: {}", to, answer.statusMessage));
  }

  void connect_any() {
    if (client) return;
    std::vector<std::string> problems;
    for (const auto& candidate : addresses) {
      try {
        connect(candidate);
        return;
      } catch (const TException& e) {
        problems.push_back(fmt::format("{}: {}", candidate, text_of(e)));
      }
    }
    throw Unreachable(
        fmt::format("no master answers ({}); is iotcloud-master running? Say where with --master HOST:PORT or the "
                    "environment variable IOTCLOUD_MASTER",
                    fmt::join(problems, "; ")));
  }

  /// Connects to the next of the addresses, in turn, that answers. \return false: none but the last one does
  bool connect_other() {
    const std::string last = address;
    auto at = std::find(addresses.begin(), addresses.end(), last);
    for (std::size_t tried = 0; tried < addresses.size(); ++tried) {
      at = at == addresses.end() || at + 1 == addresses.end() ? addresses.begin() : at + 1;
      if (*at == last) continue;
      try {
        connect(*at);
        return true;
      } catch (const TException&) {  // the next one may answer
      }
    }
    return false;
  }

  template <typename Answer, typename... Parameters, typename... Arguments>
  Answer ask(void (Client::*question)(Answer&, Parameters...), const Arguments&... arguments) {
    connect_any();
    try {
      Answer answer;
      (client.get()->*question)(answer, arguments...);
      return answer;
    } catch (const wire::TMasterError& e) {
      throw RequestFailed(fmt::format("master {}: {}", address, e.reason));
    } catch (const TApplicationException& e) {
      if (e.getType() == TApplicationException::UNKNOWN_METHOD) {
        throw RequestFailed(
            fmt::format("master {} runs an older version, which does not know this question: update it", address));
      }
      throw RequestFailed(fmt::format("master {}: {}", address, e.what()));
    } catch (const TException& e) {
      client.reset();
      throw RequestFailed(fmt::format("master {} did not answer the question: {}", address, text_of(e)));
    }
  }

  /// Asks for a list.
  template <typename Own, typename Wire>
  std::vector<Own> list(void (Client::*question)(std::vector<Wire>&)) {
    std::vector<Own> all;
    for (auto& item : ask(question)) discovery::fill_own(item, all.emplace_back());
    return all;
  }

  /// Converts an order to its Thrift struct, and gives it.
  template <typename Own, typename Answer, typename Wire, typename... Parameters, typename... Arguments>
  auto order(milliseconds limit, const Own& own, void (Client::*method)(Answer&, const Wire&, Parameters...),
             const Arguments&... arguments) {
    return from_wire(give(limit, method, as_wire<Wire>(own), arguments...));
  }
  template <typename Own, typename Method, typename... Arguments>
  auto order(const Own& own, Method method, const Arguments&... arguments) {
    return order(answer_limit(own.wait), own, method, arguments...);
  }

  /// How long the answer to an order may take.
  static milliseconds answer_limit(const WaitLimit& wait, std::size_t steps = 1) {
    return std::min(wait.value_or(longest_own_wait), longest_own_wait) * static_cast<std::int64_t>(steps) +
           order_margin;
  }

  template <typename Answer, typename... Parameters, typename... Arguments>
  Answer give(milliseconds limit, void (Client::*method)(Answer&, Parameters...), const Arguments&... arguments) {
    const auto patience = std::chrono::steady_clock::now() + election_patience;
    std::size_t out_of_reach = 0;  ///< masters in a row that named a leader which must not see the token
    connect_any();
    while (true) {
      connection->set_answer_limit(limit);
      Answer answer;
      try {
        (client.get()->*method)(answer, arguments...);
      } catch (const TApplicationException& e) {
        throw RequestFailed(fmt::format("master {}: {}", address, e.what()));
      } catch (const TException& e) {
        client.reset();
        throw RequestFailed(
            fmt::format("the answer of master {} was lost ({}): the order may have been taken; `iotcloud "
                        "drivers` and `iotcloud topology list` show what is there",
                        address, e.what()));
      }
      if (answer.refusal != wire::TRefusal::NOT_LEADING) return answer;
      // The master wrote nothing, so the order may be given again.
      const auto standby = address;
      const auto leader = answer.__isset.leader ? answer.leader : "";
      std::string silence, no_way;
      if (!leader.empty() && leader != standby) {
        no_way = open_way(access, leader);
        if (no_way.empty()) {
          try {
            connect(leader);
            continue;
          } catch (const TException& e) {
            silence = e.what();
          }
        } else if (++out_of_reach >= addresses.size()) {
          throw RequestFailed(no_way);  // all masters name that leader, and none of them leads
        } else if (connect_other()) {   // the leader may have another address here: the near end of a tunnel
          continue;
        }
      }
      // There is no leader, or it has just died and the other masters elect a new one.
      if (std::chrono::steady_clock::now() > patience) {
        if (!no_way.empty()) throw RequestFailed(no_way);
        if (silence.empty()) return answer;
        throw Unreachable(fmt::format("master {} is on standby and names {} as the leader, which does not answer: {}",
                                      standby, leader, silence));
      }
      out_of_reach = 0;
      std::this_thread::sleep_for(election_pause);
      if (!client) connect_any();
    }
  }
};

MasterClient::MasterClient(std::vector<std::string> addresses, MasterAccess access, milliseconds election_patience)
    : impl_(std::make_unique<Impl>()) {
  for (const auto& address : addresses) {
    split(address);
    if (const auto why = open_way(access, address); !why.empty()) throw std::invalid_argument(why);
  }
  impl_->addresses = std::move(addresses);
  impl_->access = std::move(access);
  impl_->election_patience = election_patience;
}

MasterClient::~MasterClient() = default;

const std::string& MasterClient::address() const {
  return impl_->address;
}

MasterStatus MasterClient::status() {
  return as_own<MasterStatus>(impl_->ask(&Client::getStatus));
}

std::vector<discovery::GatewayStatus> MasterClient::gateways() {
  return impl_->list<discovery::GatewayStatus>(&Client::listGateways);
}

std::vector<discovery::DriverRecord> MasterClient::drivers() {
  std::vector<discovery::DriverRecord> drivers;
  for (auto& sensor : impl_->ask(&Client::listDrivers))
    drivers.push_back(discovery::from_wire(std::move(sensor), "the master's answer"));
  return drivers;
}

std::vector<discovery::TopologyStatus> MasterClient::topologies() {
  return impl_->list<discovery::TopologyStatus>(&Client::listTopologies);
}

std::vector<discovery::PoolRecord> MasterClient::pools() {
  return impl_->list<discovery::PoolRecord>(&Client::listPools);
}

std::vector<ListedOrder> MasterClient::orders() {
  return impl_->list<ListedOrder>(&Client::listOrders);
}

std::string MasterClient::backup() {
  return impl_->ask(&Client::exportOrders);
}

DriverHistory MasterClient::history(const std::vector<std::string>& instances,
                                    const std::vector<discovery::GatewayId>& gateways, std::int32_t most) {
  return as_own<DriverHistory>(impl_->ask(&Client::getHistory, instances, texts(gateways), most));
}

LogPart MasterClient::read_log(const discovery::GatewayId& gateway, const discovery::InstanceId& instance,
                               const std::string& position, std::int32_t most_bytes) {
  return as_own<LogPart>(impl_->ask(&Client::readLog, gateway, instance, position, most_bytes));
}

discovery::ChannelLook MasterClient::look_at_channel(const discovery::GatewayId& gateway,
                                                     const discovery::LookRequest& request) {
  return without_problem(as_own<discovery::ChannelLook>(
      impl_->ask(&Client::lookAtChannel, gateway.str(), as_wire<discovery::wire::TLookRequest>(request))));
}

discovery::ChannelLook MasterClient::hand_message(const discovery::GatewayId& gateway,
                                                  const discovery::HandedMessage& message) {
  return without_problem(as_own<discovery::ChannelLook>(
      impl_->ask(&Client::handMessage, gateway.str(), as_wire<discovery::wire::THandedMessage>(message))));
}

GatewayPlugins MasterClient::plugins(const std::vector<discovery::GatewayId>& gateways) {
  return as_own<GatewayPlugins>(impl_->ask(&Client::listPlugins, texts(gateways)));
}

std::vector<discovery::TopologyEvent> MasterClient::topology_history(const discovery::TopologyName& topology) {
  std::vector<discovery::TopologyEvent> events;
  for (auto& event : impl_->ask(&Client::getTopologyHistory, topology.str()))
    discovery::fill_own(event, events.emplace_back());
  return events;
}

LogPart MasterClient::read_worker_log(const discovery::PlaceId& place, const std::string& position,
                                      std::int32_t most_bytes) {
  return as_own<LogPart>(impl_->ask(&Client::readWorkerLog, place.topology.str(), place.number, position, most_bytes));
}

std::string MasterClient::worker_page(const discovery::TopologyName& topology, const std::string& worker,
                                      const std::string& target) {
  return impl_->ask(&Client::readWorkerPage, topology.str(), worker, target);
}

OrderResult MasterClient::deploy(const DeployRequest& request) {
  return impl_->order(request, &Client::deploy);
}
OrderResult MasterClient::undeploy(const InstanceSelection& selection) {
  return impl_->order(selection, &Client::undeploy);
}
OrderResult MasterClient::start(const InstanceSelection& selection) {
  return impl_->order(selection, &Client::start);
}
OrderResult MasterClient::stop(const InstanceSelection& selection) {
  return impl_->order(selection, &Client::stop);
}
OrderResult MasterClient::update_metadata(const InstanceSelection& selection, const MetadataChanges& changes) {
  return impl_->order(selection, &Client::updateMetadata, changes);
}
OrderResult MasterClient::change_deployment(const DeploymentChange& change) {
  return impl_->order(change, &Client::changeDeployment);
}
OrderResult MasterClient::drain(const GatewaySelection& selection) {
  return impl_->order(selection, &Client::drain);
}
OrderResult MasterClient::undrain(const GatewaySelection& selection) {
  return impl_->order(selection, &Client::undrain);
}
OrderResult MasterClient::update(const UpdateRequest& request, std::size_t steps) {
  auto wait = request.selection.wait;
  if (wait) *wait += request.settle;
  return impl_->order(Impl::answer_limit(wait, 2 * steps + 1), request, &Client::update);
}
OrderResult MasterClient::give(const std::string& kind, const std::string& json, const WaitLimit& wait,
                               std::size_t steps) {
  return from_wire(impl_->give(Impl::answer_limit(wait, steps), &Client::giveOrder, kind, json));
}
TopologyResult MasterClient::order(const TopologyRequest& request) {
  return impl_->order(request, &Client::orderTopology);
}
UploadResult MasterClient::offer_plugin(const PluginOffer& offer, const std::vector<discovery::GatewayId>& gateways) {
  return impl_->order(Impl::answer_limit(read_limit), offer, &Client::offerPlugin, texts(gateways));
}
UploadResult MasterClient::offer_library(const PluginOffer& offer) {
  return impl_->order(Impl::answer_limit(read_limit), offer, &Client::offerLibrary);
}
UploadResult MasterClient::send_plugin(const std::string& upload, std::int64_t offset, const std::string& bytes) {
  return from_wire(impl_->ask(&Client::sendPlugin, upload, offset, bytes));
}
UploadResult MasterClient::finish_plugin(const std::string& upload) {
  return from_wire(impl_->ask(&Client::finishPlugin, upload));
}

}  // namespace iotcloud::master::cli
