#pragma once

#include <chrono>
#include <cstdint>
#include <stop_token>
#include <string>

#include <iotcloud/discovery/submissions.h>
#include <iotcloud/master/gateways/site_client.h>
#include <iotcloud/master/orders/answers.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::master {

/// The credentials that this master shows to the pools' Thrift services.
struct PoolAccess {
  security::TlsFiles tls;  ///< for pools that speak TLS
  /// Its first line is the token for pools that speak TLS; empty: none. "{pool}" in it stands for a pool's id.
  std::string token_file;
};

/// The address of the pool's Thrift service. \throws config::Error when this master cannot or must not call it, with
/// the reason.
SiteAddress address_of(const discovery::PoolRecord& pool, const PoolAccess& access);

/// Ask a pool's Thrift service, each time on a new connection; `limit` holds for each answer that a call needs. Thread
/// safe. \param pool the id that the pool must have: its record, which every worker may write, may lead elsewhere. With
/// TLS the certificate there must name it, before it is shown the token.
/// \throws config::Error with the pool's own words, or why it could not be asked.
LogPart pool_read_log(const SiteAddress& site, const discovery::PoolId& pool, const discovery::PlaceId& place,
                      const std::string& position, std::int32_t most_bytes, std::chrono::milliseconds limit);

/// Send a component library to a pool, under the same rules. \return the upload's id; empty when the pool has the
/// library already.
std::string pool_offer_library(const SiteAddress& site, const discovery::PoolId& pool, const PluginOffer& offer,
                               std::chrono::milliseconds limit);
void pool_send_library(const SiteAddress& site, const discovery::PoolId& pool, const std::string& upload,
                       std::int64_t offset, const std::string& bytes, std::chrono::milliseconds limit);
void pool_finish_library(const SiteAddress& site, const discovery::PoolId& pool, const std::string& upload,
                         std::chrono::milliseconds limit);

/// How long it may take to pass a library on.
struct PassLimits {
  std::chrono::milliseconds answer{10'000};    ///< for each answer of a pool
  std::chrono::milliseconds transfer{60'000};  ///< for all pieces, and a second more for each megabyte
};

/// Sends a library that one pool has to another one. \param file its plain name, for people. \param stop ends it
/// between two pieces. \throws config::Error
void pass_library(const SiteAddress& from, const discovery::PoolId& giver, const SiteAddress& to,
                  const discovery::PoolId& taker, const std::string& file, const std::string& sha256,
                  const PassLimits& limits, const std::stop_token& stop);

}  // namespace iotcloud::master
