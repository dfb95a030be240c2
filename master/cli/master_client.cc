#include <algorithm>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <thrift/TApplicationException.h>
#include <thrift/transport/TTransportException.h>

#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/thrift/listen_settings.h>
#include <iotcloud/config/thrift/thrift_client.h>
#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

using apache::thrift::TApplicationException;
using apache::thrift::TException;
using apache::thrift::transport::TTransportException;
using std::chrono::milliseconds;
using wire::TMasterAPIServiceClient;

namespace {

constexpr milliseconds connect_limit{3'000};
constexpr milliseconds read_limit{30'000};
/// For the first answer on a connection: a master that waits for its registry takes three seconds.
constexpr milliseconds first_answer_limit{5'000};
/// What a master takes for an order on top of the wait it was asked for.
constexpr milliseconds order_margin{30'000};
/// Longest wait of a master that is not asked for one.
constexpr int longest_own_wait_ms = 600'000;
constexpr milliseconds election_pause{200};

config::HostAndPort split(const std::string& address) {
  try {
    return config::split_address(address);
  } catch (const config::Error&) {
    throw std::invalid_argument(
        fmt::format("\"{}\" is no address of a master: give HOST:PORT, for example 127.0.0.1:12904", address));
  }
}

}  // namespace

struct MasterClient::Impl {
  std::vector<std::string> addresses;
  MasterAccess access;
  milliseconds election_patience{};
  std::string address;  ///< of the connection, and of the last one after it broke
  std::unique_ptr<config::ThriftClient> connection;
  std::unique_ptr<TMasterAPIServiceClient> client;

  /// What went wrong, and what may be missing.
  std::string text_of(const TException& e) const {
    const auto* transport = dynamic_cast<const TTransportException*>(&e);
    const bool no_tls = access.tls.empty() && transport != nullptr &&
                        (transport->getType() == TTransportException::END_OF_FILE ||
                         transport->getType() == TTransportException::CORRUPTED_DATA);
    return no_tls ? fmt::format("{} (does it ask for TLS? --ca, --certificate and --key)", e.what()) : e.what();
  }

  /// \throws TException when there is no master at this address.
  void connect(const std::string& to) {
    client.reset();
    const auto [host, port] = split(to);
    config::ThriftClientOptions options;
    options.host = host;
    options.port = port;
    options.tls = access.tls;
    options.connect_limit = connect_limit;
    options.answer_limit = first_answer_limit;
    auto fresh = std::make_unique<config::ThriftClient>(options);
    auto asking = std::make_unique<TMasterAPIServiceClient>(fresh->protocol());
    open(*asking, to);
    fresh->set_answer_limit(read_limit);
    connection = std::move(fresh);
    client = std::move(asking);
    address = to;
  }

  /// A master that hangs still takes connections: one is there when it has answered something.
  void open(TMasterAPIServiceClient& fresh, const std::string& to) const {
    if (access.token.empty()) {
      try {
        wire::TMasterStatus ignored;
        fresh.getStatus(ignored);
      } catch (const wire::TMasterError&) {
        // That is an answer.
      }
      return;
    }
    discovery::wire::TResponse answer;
    fresh.authenticate(answer, access.token);
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
        problems.push_back(fmt::format("{}: {}", candidate, text_of(e)));
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
    } catch (const TApplicationException& e) {
      throw Failed(fmt::format("master {}: {}", address, e.what()));
    } catch (const TException& e) {
      client.reset();
      throw Failed(fmt::format("master {} did not answer the question: {}", address, text_of(e)));
    }
  }

  template <typename Answer = wire::TOrderResponse, typename Give>
  Answer order(std::int64_t wait_ms, Give&& give, std::size_t steps = 1) {
    const auto patience = std::chrono::steady_clock::now() + election_patience;
    connect_any();
    while (true) {
      const auto own_wait = wait_ms > 0 ? std::min<std::int64_t>(wait_ms, longest_own_wait_ms) : longest_own_wait_ms;
      connection->set_answer_limit(milliseconds{own_wait} * static_cast<std::int64_t>(steps) + order_margin);
      Answer answer;
      try {
        give(*client, answer);
      } catch (const TApplicationException& e) {
        throw Failed(fmt::format("master {}: {}", address, e.what()));
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

MasterClient::MasterClient(std::vector<std::string> addresses, MasterAccess access, milliseconds election_patience)
    : impl_(std::make_unique<Impl>()) {
  for (const auto& address : addresses) split(address);
  impl_->addresses = std::move(addresses);
  impl_->access = std::move(access);
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
      read_limit.count(), [&](auto& client, auto& answer) { client.offerPlugin(answer, offer, gateways); });
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
