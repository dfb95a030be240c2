#pragma once

#include <chrono>
#include <functional>
#include <string>

#include <iotcloud/discovery/records.h>

namespace iotcloud::master {

class DirectGateways;

/// The options of a master.
struct MasterOptions {
  std::string id = "master";  ///< its name in logs and in `iotcloud status`
  /// host:port of this master's Thrift API as other machines reach it. While this master leads, standby masters name
  /// this address as the leader's.
  std::string address;
  discovery::Paths paths;
  /// How long an order waits for its outcomes when the request does not say.
  std::chrono::milliseconds outcome_timeout{30'000};
  /// True: an order for a lost gateway is recorded, and its outcome is `pending`. False: it is not recorded, and
  /// `failed`.
  bool record_for_lost_gateways = true;
  /// Signs orders to gateways: gets the path of the order's node and its JSON, and returns the bytes to write. Empty:
  /// orders are not signed.
  std::function<std::string(const std::string& path, const std::string& bytes)> seal{};
  /// Whether a trusted master signed what stands at that path, so that this master may change and sign it. Empty: it
  /// may, whoever wrote it.
  std::function<bool(const std::string& path, const std::string& bytes)> is_sealed{};
  DirectGateways* direct = nullptr;  ///< gateways that are called, not ordered; outlives the master; null: none
};

}  // namespace iotcloud::master
