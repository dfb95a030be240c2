#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/records.h>

/// How a gateway says that it does not trust the registry's orders any more, and how a master answers.
namespace iotcloud::discovery {

/// Why a gateway follows no orders: persistent node freeze_path(), JSON, written and removed by the gateway.
struct FreezeRecord {
  std::string reason;         ///< for people
  std::int64_t since_ms = 0;  ///< Unix time
  std::string token;          ///< random, of this freeze: an adoption names it
  bool lasting = false;       ///< true: only an adoption ends it; false: the orders' own node coming back does, too
  static constexpr const char* what = "the mark of a frozen gateway";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(reason, usual), IOTCLOUD_FIELD(since_ms, usual),
                                            IOTCLOUD_FIELD(token, required), IOTCLOUD_FIELD(lasting, usual)};
  friend bool operator==(const FreezeRecord&, const FreezeRecord&) = default;
};

/// A master's answer to one freeze of one gateway: the orders are meant as they stand now, also when there are none.
/// JSON, the data of the node Paths::orders(), which is empty before the first adoption.
struct Adoption {
  std::string token;       ///< FreezeRecord::token
  std::int64_t epoch = 0;  ///< the master's: orders that come later and have an older one are not followed
  static constexpr const char* what = "an adoption";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(token, required), IOTCLOUD_FIELD(epoch, usual)};
  friend bool operator==(const Adoption&, const Adoption&) = default;
};

/// `/iot/gateways/<id>/frozen`: FreezeRecord.
std::string freeze_path(const Paths& paths, const GatewayId& gateway);

/// The JSON of a record.
std::string encode(const FreezeRecord& record);
std::string encode(const Adoption& adoption);
/// As decode_order().
FreezeRecord decode_freeze(const std::string& bytes, const std::string& path);
/// As decode_order().
Adoption decode_adoption(const std::string& bytes, const std::string& path);

}  // namespace iotcloud::discovery
