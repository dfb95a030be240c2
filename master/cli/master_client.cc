#include <algorithm>
#include <limits>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <thrift/TApplicationException.h>
#include <thrift/TOutput.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TSocket.h>
#include <thrift/transport/TTransportException.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

using apache::thrift::TException;
using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TFramedTransport;
using apache::thrift::transport::TSocket;
using apache::thrift::transport::TTransportException;
using wire::TMasterAPIServiceClient;

namespace {

constexpr int connect_timeout_ms = 3'000;
constexpr int read_timeout_ms = 30'000;
/// For the first answer on a connection: a master that waits for its registry takes three seconds.
constexpr int first_answer_timeout_ms = 5'000;
/// What a master takes for an order on top of the wait it was asked for.
constexpr int order_margin_ms = 30'000;
/// Longest wait of a master that is not asked for one.
constexpr int longest_own_wait_ms = 600'000;
constexpr std::chrono::milliseconds election_pause{200};

std::pair<std::string, int> split(const std::string& address) {
  const auto colon = address.rfind(':');
  try {
    std::size_t used = 0;
    const int port = std::stoi(address.substr(colon == std::string::npos ? address.size() : colon + 1), &used);
    if (colon > 0 && port > 0 && port < 65536 && colon + 1 + used == address.size())
      return {address.substr(0, colon), port};
  } catch (const std::logic_error&) {
    // falls through to the message that names the whole address
  }
  throw std::invalid_argument(
      fmt::format("\"{}\" is no address of a master: give HOST:PORT, for example 127.0.0.1:12904", address));
}

}  // namespace

struct MasterClient::Impl {
  std::vector<std::string> addresses;
  std::string token;
  std::chrono::milliseconds election_patience;
  std::string address;  ///< of the connection, and of the last one after it broke
  std::shared_ptr<TSocket> socket;
  std::unique_ptr<TMasterAPIServiceClient> client;

  /// \throws TException when there is no master at this address.
  void connect(const std::string& to) {
    client.reset();
    const auto [host, port] = split(to);
    socket = std::make_shared<TSocket>(host, port);
    socket->setConnTimeout(connect_timeout_ms);
    socket->setRecvTimeout(first_answer_timeout_ms);
    socket->setSendTimeout(read_timeout_ms);
    auto transport = std::make_shared<TFramedTransport>(socket);
    transport->open();
    auto fresh = std::make_unique<TMasterAPIServiceClient>(std::make_shared<TBinaryProtocol>(transport));
    open(*fresh, to);
    socket->setRecvTimeout(read_timeout_ms);
    client = std::move(fresh);
    address = to;
  }

  /// A master that hangs still takes connections: one is there when it has answered something.
  void open(TMasterAPIServiceClient& fresh, const std::string& to) const {
    if (token.empty()) {
      try {
        wire::TMasterStatus ignored;
        fresh.getStatus(ignored);
      } catch (const wire::TMasterError&) {
        // That is an answer.
      }
      return;
    }
    discovery::wire::TResponse answer;
    fresh.authenticate(answer, token);
    if (answer.state != discovery::wire::TResponseState::SUCCESS)
      throw Failed(fmt::format("master {}: {}", to, answer.statusMessage));
  }

  void connect_any() {
    if (client) return;
    std::vector<std::string> problems;
    for (const auto& candidate : addresses) {
      try {
        connect(candidate);
        return;
      } catch (const TException& e) {
        problems.push_back(fmt::format("{}: {}", candidate, e.what()));
      }
    }
    throw Unreachable(
        fmt::format("no master answers ({}); is iotcloud-master running? Say where with --master HOST:PORT or the "
                    "environment variable IOTCLOUD_MASTER",
                    fmt::join(problems, "; ")));
  }

  template <typename Ask>
  auto read(Ask&& ask) {
    connect_any();
    try {
      return ask(*client);
    } catch (const wire::TMasterError& e) {
      throw Failed(fmt::format("master {}: {}", address, e.reason));
    } catch (const TException& e) {
      client.reset();
      throw Failed(fmt::format("master {} did not answer the question: {}", address, e.what()));
    }
  }

  template <typename Answer = wire::TOrderResponse, typename Give>
  Answer order(std::int64_t wait_ms, Give&& give, std::size_t steps = 1) {
    const auto patience = std::chrono::steady_clock::now() + election_patience;
    connect_any();
    while (true) {
      const auto own_wait = wait_ms > 0 ? std::min<std::int64_t>(wait_ms, longest_own_wait_ms) : longest_own_wait_ms;
      const auto longest = own_wait * static_cast<std::int64_t>(steps) + order_margin_ms;
      socket->setRecvTimeout(static_cast<int>(std::min<std::int64_t>(longest, std::numeric_limits<int>::max())));
      Answer answer;
      try {
        give(*client, answer);
      } catch (const TException& e) {
        client.reset();
        throw Failed(
            fmt::format("the answer of master {} was lost ({}): the order may have been taken; `iotcloud "
                        "drivers` and `iotcloud topology list` show what is there",
                        address, e.what()));
      }
      if (answer.refusal != wire::TRefusal::NOT_LEADING) return answer;
      // Nothing was written: the order may be given again.
      const auto standby = address;
      const auto leader = answer.__isset.leader ? answer.leader : "";
      std::string silence;
      if (!leader.empty() && leader != standby) {
        try {
          connect(leader);
          continue;
        } catch (const TException& e) {
          silence = e.what();
        }
      }
      // No leader, or one that has just died: the others are electing another.
      if (std::chrono::steady_clock::now() > patience) {
        if (silence.empty()) return answer;
        throw Unreachable(fmt::format("master {} is on standby and names {} as the leader, which does not answer: {}",
                                      standby, leader, silence));
      }
      std::this_thread::sleep_for(election_pause);
      if (!client) connect_any();
    }
  }
};

MasterClient::MasterClient(std::vector<std::string> addresses, std::string token,
                           std::chrono::milliseconds election_patience)
    : impl_(std::make_unique<Impl>()) {
  apache::thrift::GlobalOutput.setOutputFunction([](const char*) {});  // every error comes as an exception too
  for (const auto& address : addresses) split(address);
  impl_->addresses = std::move(addresses);
  impl_->token = std::move(token);
  impl_->election_patience = election_patience;
}

MasterClient::~MasterClient() = default;

const std::string& MasterClient::address() const {
  return impl_->address;
}

wire::TMasterStatus MasterClient::status() {
  return impl_->read([](auto& client) {
    wire::TMasterStatus out;
    client.getStatus(out);
    return out;
  });
}

std::vector<discovery::wire::TSite> MasterClient::gateways() {
  return impl_->read([](auto& client) {
    std::vector<discovery::wire::TSite> out;
    client.listGateways(out);
    return out;
  });
}

std::vector<discovery::wire::TSensor> MasterClient::drivers() {
  return impl_->read([](auto& client) {
    std::vector<discovery::wire::TSensor> out;
    client.listDrivers(out);
    return out;
  });
}

std::vector<wire::TTopology> MasterClient::topologies() {
  return impl_->read([](auto& client) {
    std::vector<wire::TTopology> out;
    client.listTopologies(out);
    return out;
  });
}

std::vector<wire::TOrder> MasterClient::orders() {
  return impl_->read([](auto& client) {
    std::vector<wire::TOrder> out;
    client.listOrders(out);
    return out;
  });
}

wire::TDriverHistory MasterClient::history(const std::vector<std::string>& instances,
                                           const std::vector<std::string>& gateways, std::int32_t most) {
  return impl_->read([&](auto& client) {
    wire::TDriverHistory out;
    client.getHistory(out, instances, gateways, most);
    return out;
  });
}

wire::TLogPart MasterClient::read_log(const std::string& gateway, const std::string& instance,
                                      const std::string& position, std::int32_t most_bytes) {
  return impl_->read([&](auto& client) {
    wire::TLogPart out;
    client.readLog(out, gateway, instance, position, most_bytes);
    return out;
  });
}

wire::TOrderResponse MasterClient::deploy(const wire::TDeployRequest& request) {
  return impl_->order(request.waitMs, [&](auto& client, auto& answer) { client.deploy(answer, request); });
}

wire::TOrderResponse MasterClient::undeploy(const wire::TInstanceSelection& selection) {
  return impl_->order(selection.waitMs, [&](auto& client, auto& answer) { client.undeploy(answer, selection); });
}

wire::TOrderResponse MasterClient::start(const wire::TInstanceSelection& selection) {
  return impl_->order(selection.waitMs, [&](auto& client, auto& answer) { client.start(answer, selection); });
}

wire::TOrderResponse MasterClient::stop(const wire::TInstanceSelection& selection) {
  return impl_->order(selection.waitMs, [&](auto& client, auto& answer) { client.stop(answer, selection); });
}

wire::TOrderResponse MasterClient::update_metadata(const wire::TInstanceSelection& selection,
                                                   const std::map<std::string, std::string>& changes) {
  return impl_->order(selection.waitMs,
                      [&](auto& client, auto& answer) { client.updateMetadata(answer, selection, changes); });
}

wire::TOrderResponse MasterClient::change_deployment(const wire::TDeploymentChange& change) {
  return impl_->order(change.waitMs, [&](auto& client, auto& answer) { client.changeDeployment(answer, change); });
}

wire::TOrderResponse MasterClient::drain(const wire::TGatewaySelection& selection) {
  return impl_->order(selection.waitMs, [&](auto& client, auto& answer) { client.drain(answer, selection); });
}

wire::TOrderResponse MasterClient::undrain(const wire::TGatewaySelection& selection) {
  return impl_->order(selection.waitMs, [&](auto& client, auto& answer) { client.undrain(answer, selection); });
}

wire::TOrderResponse MasterClient::update(const wire::TUpdateRequest& request, std::size_t steps) {
  return impl_->order(
      request.selection.waitMs > 0 ? request.selection.waitMs + request.settleMs : 0,
      [&](auto& client, auto& answer) { client.update(answer, request); }, 2 * steps + 1);
}

wire::TUploadResponse MasterClient::offer_plugin(const wire::TPluginOffer& offer,
                                                 const std::vector<std::string>& gateways) {
  return impl_->order<wire::TUploadResponse>(
      read_timeout_ms, [&](auto& client, auto& answer) { client.offerPlugin(answer, offer, gateways); });
}

wire::TUploadResponse MasterClient::send_plugin(const std::string& upload, std::int64_t offset,
                                                const std::string& bytes) {
  return impl_->read([&](auto& client) {
    wire::TUploadResponse out;
    client.sendPlugin(out, upload, offset, bytes);
    return out;
  });
}

wire::TUploadResponse MasterClient::finish_plugin(const std::string& upload) {
  return impl_->read([&](auto& client) {
    wire::TUploadResponse out;
    client.finishPlugin(out, upload);
    return out;
  });
}

wire::TTopologyResponse MasterClient::order(const wire::TTopologyRequest& request) {
  return impl_->order<wire::TTopologyResponse>(
      request.waitMs, [&](auto& client, auto& answer) { client.orderTopology(answer, request); });
}

}  // namespace iotcloud::master::cli
