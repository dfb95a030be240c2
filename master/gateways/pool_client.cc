#include <algorithm>
#include <chrono>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <thrift/TApplicationException.h>

#include "iotcloud/topology/pool/TPoolService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/discovery/description/wire.h>
#include <iotcloud/master/gateways/pool_client.h>
#include <iotcloud/rpc/thrift_client.h>

namespace iotcloud::master {

using discovery::PoolId;
using std::chrono::milliseconds;
using topology::wire::TPoolServiceClient;

namespace {

constexpr milliseconds pool_connect_limit{2'000};
/// In an answer of a pool, which has half a megabyte of a library at most.
constexpr int most_pool_answer_bytes = 2 << 20;
/// A transfer of a library may take a millisecond more for each so many bytes.
constexpr std::int64_t slowest_bytes_per_ms = 1000;
/// The largest library that a pool may take (libraries.upload_limit_mb).
constexpr std::int64_t largest_library = std::int64_t{4096} << 20;

/// Asks the pool with this id and no other. All errors become config::Error.
template <typename Question>
void ask_pool(const SiteAddress& site, const PoolId& pool, milliseconds limit, Question&& question) {
  try {
    rpc::ThriftClientOptions options;
    options.host = site.host;
    options.port = site.port;
    options.tls = site.tls;
    options.daemon = security::NamedDaemon{security::NamedDaemon::Kind::pool, pool.str()};
    options.answer_limit = std::max(limit, milliseconds{1});
    options.connect_limit = std::min(options.answer_limit, pool_connect_limit);
    options.most_bytes = most_pool_answer_bytes;
    TPoolServiceClient client(rpc::ThriftClient(options).protocol());
    if (!site.token_file.empty() && !site.tls.empty()) {
      discovery::wire::TResponse answer;
      client.authenticate(answer, token_in(site.token_file));
      if (answer.state != discovery::wire::TResponseState::SUCCESS) throw config::Error(answer.statusMessage);
    }
    topology::wire::TPoolPing answer;
    client.ping(answer);
    if (answer.pool != pool.str()) {
      throw config::Error(
          fmt::format("at {}:{} another pool answers ({}); a pool whose Thrift service is on loopback can be asked by "
                      "a master of its "
                      "own machine only: give it an address, TLS and tokens (config/pool.yaml)",
                      site.host, site.port, answer.pool));
    }
    question(client);
  } catch (const topology::wire::TPoolError& e) {
    throw config::Error(e.reason);
  } catch (const apache::thrift::TException& e) {
    throw config::Error(fmt::format("pool {} at {}:{} does not answer: {}", pool, site.host, site.port, e.what()));
  }
}

}  // namespace

SiteAddress address_of(const discovery::PoolRecord& pool, const PoolAccess& access) {
  if (!pool.tls) {
    // Every worker may write such a record, and what is sent to a pool is for pools only.
    if (!access.tls.empty() && !config::is_loopback(pool.host)) {
      throw config::Error(fmt::format(
          "the record of pool {} leads to {} without TLS, and this master, which has TLS, asks only pools of "
          "its own machine so; give the pool TLS and tokens (thrift, in its pool.yaml)",
          pool.id, pool.host));
    }
    return {pool.host, pool.port, {}, ""};
  }
  if (access.tls.empty()) {
    throw config::Error(
        fmt::format("pool {} speaks TLS, and this master has no certificate; give it one "
                    "(api: {{tls: {{ca, certificate, key}}}})",
                    pool.id));
  }
  constexpr std::string_view id = "{pool}";
  std::string token_file = access.token_file;
  if (const auto at = token_file.find(id); at != std::string::npos) token_file.replace(at, id.size(), pool.id.str());
  return {pool.host, pool.port, access.tls, token_file};
}

LogPart pool_read_log(const SiteAddress& site, const PoolId& pool, const discovery::PlaceId& place,
                      const std::string& position, std::int32_t most_bytes, milliseconds limit) {
  topology::wire::TWorkerLogPart part;
  ask_pool(site, pool, limit,
           [&](auto& client) { client.readLog(part, place.topology, place.number, position, most_bytes); });
  return {part.text, part.position};
}

std::string pool_offer_library(const SiteAddress& site, const PoolId& pool, const PluginOffer& offer,
                               milliseconds limit) {
  const auto wire_offer = discovery::as_wire<topology::wire::TLibraryOffer>(offer);
  std::string upload;
  ask_pool(site, pool, limit, [&](auto& client) { client.offerLibrary(upload, wire_offer); });
  return upload;
}

void pool_send_library(const SiteAddress& site, const PoolId& pool, const std::string& upload, std::int64_t offset,
                       const std::string& bytes, milliseconds limit) {
  ask_pool(site, pool, limit, [&](auto& client) { client.sendLibrary(upload, offset, bytes); });
}

void pool_finish_library(const SiteAddress& site, const PoolId& pool, const std::string& upload, milliseconds limit) {
  ask_pool(site, pool, limit, [&](auto& client) { client.finishLibrary(upload); });
}

void pass_library(const SiteAddress& from, const PoolId& giver, const SiteAddress& to, const PoolId& taker,
                  const std::string& file, const std::string& sha256, const PassLimits& limits,
                  const std::stop_token& stop) {
  const auto limit = limits.answer;
  ask_pool(from, giver, limit, [&](auto& source) {
    topology::wire::TKeptLibrary kept;
    source.describeLibrary(kept, sha256);
    if (kept.size < 0 || kept.size > largest_library)
      throw config::Error(fmt::format("pool {} says that {} has {} bytes", giver, file, kept.size));
    const std::string upload = pool_offer_library(to, taker, {file, sha256, kept.size, kept.signature}, limit);
    if (upload.empty()) return;
    const auto until =
        std::chrono::steady_clock::now() + limits.transfer + milliseconds{kept.size / slowest_bytes_per_ms};
    for (std::int64_t offset = 0; offset < kept.size;) {
      if (stop.stop_requested()) throw config::Error("this master ends");
      if (std::chrono::steady_clock::now() >= until) {
        throw config::Error(
            fmt::format("after {} of {} bytes its time is over: less than {} KB a second came from pool {}", offset,
                        kept.size, slowest_bytes_per_ms, giver));
      }
      std::string piece;
      source.readLibrary(piece, sha256, offset);
      if (piece.empty()) throw config::Error(fmt::format("pool {} has less of {} than it says", giver, file));
      if (std::cmp_greater(piece.size(), kept.size - offset))
        throw config::Error(fmt::format("pool {} has more of {} than it says", giver, file));
      pool_send_library(to, taker, upload, offset, piece, limit);
      offset += static_cast<std::int64_t>(piece.size());
    }
    pool_finish_library(to, taker, upload, limit);
  });
}

}  // namespace iotcloud::master
