// A backup of the registry, as a person gives it to `iotcloud registry import`, and the order that a master gets of it.
#include <string>

#include <nlohmann/json.hpp>

#include "iotcloud/config/error.h"
#include "iotcloud/discovery/description/json.h"
#include "iotcloud/master/orders/backup_file.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

namespace {

std::size_t orders_of(const master::Backup& backup) {
  std::size_t orders = backup.topologies.size();
  for (const auto& gateway : backup.gateways) orders += gateway.orders.size();
  return orders;
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(backup, 4'000) {
  constexpr std::size_t piece = 300;  // bytes
  master::Backup backup;
  try {
    backup = master::decode_backup(std::string(fuzz::text(data, size)), "backup.json");
  } catch (const config::Error& error) {
    fuzz::must(std::string(error.what()).starts_with("backup.json"), "an error names the file");
    return;
  }
  fuzz::must(master::decode_backup(master::encode(backup), "again") == backup, "a backup is read as it was written");
  std::size_t orders = 0;
  for (const auto& one : master::pieces_of(backup, piece)) orders += orders_of(one);
  fuzz::must(orders == orders_of(backup), "the pieces have all orders");
  for (const auto& plugin : master::sent_plugins(backup.gateways))
    fuzz::must(!master::words(plugin).empty(), "a plugin has words");
}
