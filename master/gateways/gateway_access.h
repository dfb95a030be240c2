#pragma once

#include <chrono>
#include <string>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/gateways/site_client.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::master {

/// How this master calls the gateways' Thrift services: with which credentials, and how long it waits.
struct GatewayAccess {
  /// For gateways that speak TLS. A master that has them calls others only on loopback, or if they are of the original.
  security::TlsFiles tls;
  /// Its first line is the token for gateways that speak TLS; empty: none. "{gateway}" in it stands for a gateway's id,
  /// so that each gateway is shown a token of its own.
  std::string token_file;
  /// For a gateway's answer to a question about what it has, knows or did (gateway_pages.h), and for the answers of all
  /// gateways that are asked at the same time; those whose answers are missing by then are named.
  std::chrono::milliseconds answer_limit{3000}, all_answers_limit{15'000};
};

/// The address of the gateway's Thrift service. \throws config::Error when this master cannot call it, with the reason.
SiteAddress address_of(const discovery::GatewayStatus& gateway, const GatewayAccess& access);

}  // namespace iotcloud::master
