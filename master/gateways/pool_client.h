#pragma once

#include <chrono>
#include <cstdint>
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

/// The address of the pool's Thrift service. \throws config::Error when this master cannot call it, with the reason.
SiteAddress address_of(const discovery::PoolRecord& pool, const PoolAccess& access);

/// Ask a pool's Thrift service, each time on a new connection; `limit` holds for each answer that a call needs. Thread
/// safe. \param pool the id that the pool must have: an address on loopback may lead to another one.
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

/// Sends a library that one pool has to another one. \param file its plain name, for people
void pass_library(const SiteAddress& from, const discovery::PoolId& giver, const SiteAddress& to,
                  const discovery::PoolId& taker, const std::string& file, const std::string& sha256,
                  std::chrono::milliseconds limit);

}  // namespace iotcloud::master
