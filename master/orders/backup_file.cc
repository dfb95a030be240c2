#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/orders/backup_file.h>
#include <iotcloud/master/orders/node_name.h>

namespace iotcloud::master {

namespace {

constexpr std::size_t largest_file = 256'000'000;  // bytes
constexpr std::size_t shown_digits = 12;           // of a SHA-256

void check_name(const std::string& path, const char* what, const std::string& name) {
  if (!is_node_name(name))
    throw config::Error(fmt::format("{}: \"{}\" cannot be the {}: no '/' and no control characters", path, name, what));
}

}  // namespace

std::vector<SentPluginBackup> sent_plugins(const std::vector<GatewayBackup>& gateways) {
  std::vector<SentPluginBackup> sent;
  for (const auto& gateway : gateways) {
    for (const auto& order : gateway.orders) {
      if (order.sha256.empty()) continue;
      auto known = std::find_if(sent.begin(), sent.end(), [&](const auto& one) { return one.sha256 == order.sha256; });
      if (known == sent.end()) known = sent.insert(sent.end(), SentPluginBackup{order.plugin, order.sha256, {}});
      if (known->gateways.empty() || known->gateways.back() != gateway.gateway)
        known->gateways.push_back(gateway.gateway);
    }
  }
  return sent;
}

std::vector<discovery::SentLibrary> sent_libraries(const Backup& backup) {
  std::vector<discovery::SentLibrary> sent;
  for (const auto& submission : backup.submissions) {
    for (const auto& library : submission.version.libraries) {
      const auto is_this = [&](const auto& one) { return one.sha256 == library.sha256; };
      if (std::none_of(sent.begin(), sent.end(), is_this)) sent.push_back(library);
    }
  }
  return sent;
}

std::string words(const SentPluginBackup& plugin) {
  return fmt::format("{} (SHA-256 {}..., gateways {})", plugin.plugin, plugin.sha256.substr(0, shown_digits),
                     fmt::join(plugin.gateways, ", "));
}

std::string words(const Backup& backup) {
  std::size_t orders = 0;
  for (const auto& gateway : backup.gateways) orders += gateway.orders.size();
  const std::string submitted =
      backup.submissions.empty() ? "" : fmt::format(", {} submitted topologies", backup.submissions.size());
  return fmt::format("{} orders of {} gateways, {} of topologies{}", orders, backup.gateways.size(),
                     backup.topologies.size(), submitted);
}

std::string encode(const Backup& backup) {
  using Json = nlohmann::ordered_json;
  return discovery::to_json<Json>(backup).dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

void check(const Backup& backup, const std::string& path) {
  if (backup.format != Backup::current_format)
    throw config::Error(fmt::format("{}: its format is {}, and this program reads {}: use the version that wrote it",
                                    path, backup.format, Backup::current_format));
  for (const auto& gateway : backup.gateways) {
    check_name(path, "id of a gateway", gateway.gateway);
    for (const auto& order : gateway.orders) check_name(path, "id of an instance", order.instance);
  }
  for (const auto& topology : backup.topologies) check_name(path, "name of a topology", topology.topology);
  for (const auto& submission : backup.submissions) check_name(path, "name of a topology", submission.name);
}

Backup decode_backup(const std::string& text, const std::string& path) {
  auto backup = discovery::from_json<Backup>(discovery::parse_json(text, path, largest_file), path);
  check(backup, path);
  return backup;
}

std::vector<Backup> pieces_of(const Backup& backup, std::size_t bytes) {
  std::vector<Backup> pieces;
  std::size_t room = 0;
  const auto make_room = [&](std::size_t size) {
    if (!pieces.empty() && size <= room) {
      room -= size;
      return false;
    }
    pieces.push_back({backup.format, backup.made_ms, {}, {}, {}, {}});
    room = bytes - std::min(bytes, size);
    return true;
  };
  for (const auto& gateway : backup.gateways) {
    make_room(gateway.gateway.str().size());
    pieces.back().gateways.push_back({gateway.gateway, gateway.draining, {}});
    for (const auto& order : gateway.orders) {
      if (make_room(encode(order).size())) pieces.back().gateways.push_back({gateway.gateway, gateway.draining, {}});
      pieces.back().gateways.back().orders.push_back(order);
    }
  }
  for (const auto& topology : backup.topologies) {
    make_room(encode(topology.order).size());
    pieces.back().topologies.push_back(topology);
  }
  for (const auto& submission : backup.submissions) {
    make_room(encode(submission).size());
    pieces.back().submissions.push_back(submission);
  }
  return pieces;
}

}  // namespace iotcloud::master
