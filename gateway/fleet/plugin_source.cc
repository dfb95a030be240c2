#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fmt/format.h>
#include <sys/stat.h>

#include <iotcloud/config/declaration.h>
#include <iotcloud/config/error.h>
#include <iotcloud/discovery/driver_of_file.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/gateway/fleet/plugin_folder.h>
#include <iotcloud/gateway/fleet/plugin_source.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

namespace fs = std::filesystem;

namespace {

discovery::DriverName driver_name(const config::DriverDeclaration& declaration, const std::string& plugin) {
  return declaration.driver.empty() ? discovery::driver_of_file(plugin) : discovery::DriverName(declaration.driver);
}

}  // namespace

PluginSource::PluginSource(std::string folder, std::shared_ptr<processes::PluginStore> store,
                           std::shared_ptr<const security::TrustedKeys> trust, bool trust_folder)
    : folder_(std::move(folder)),
      store_(std::move(store)),
      trust_(trust ? std::move(trust) : std::make_shared<const security::TrustedKeys>()),
      trust_folder_(trust_folder) {}

PluginSource::Found PluginSource::find(const HostOrder& order) {
  check_plugin_file_name(order.plugin);
  Found found;
  std::string signature;
  if (order.sha256.empty()) {
    found.path = folder_ + "/" + order.plugin;
    signature = found.path + ".sig";
    struct stat status {};
    if (stat(found.path.c_str(), &status) != 0)
      throw config::Error(
          fmt::format("there is no plugin {} in the gateway's folder {}: {}; put it there, or send a file "
                      "with `iotcloud deploy --plugin ./{}`",
                      order.plugin, folder_, std::strerror(errno), order.plugin));
    check_plugin_file(folder_, order.plugin);
  } else {
    if (!store_)
      throw config::Error(fmt::format("{} was sent, and this gateway keeps no plugins that are sent", order.plugin));
    const auto kept = store_->path_of(order.sha256);
    if (!kept)
      throw config::Error(fmt::format(
          "the plugin {} (SHA-256 {}) is not on this gateway; send it again: iotcloud update --plugin ./{} ID",
          order.plugin, security::short_sha256(order.sha256), order.plugin));
    found.path = *kept;
    signature = store_->signature_path_of(order.sha256);
  }
  const Examined examined = examine(found.path, signature, order);
  found.identity = examined.identity;
  found.signature = examined.signature;
  found.isolated = examined.isolated;
  found.exactly = trust_->requires_signature() || !order.sha256.empty();
  return found;
}

discovery::DriverName PluginSource::driver_of(const HostOrder& order) try {
  check_plugin_file_name(order.plugin);
  const auto path = order.sha256.empty() ? folder_ + "/" + order.plugin
                    : store_             ? store_->path_of(order.sha256)
                                         : std::optional<std::string>();
  if (!path) return {};
  const auto stamp = config::stamp_of(*path);
  const Version version{order.plugin, order.sha256};
  {
    const config::MutexLock lock(mutex_);
    const auto known = drivers_.find(version);
    if (known != drivers_.end() && known->second.first == stamp) return known->second.second;
  }
  auto driver = driver_name(config::declaration_in(processes::read_file(*path, 0)), order.plugin);
  const config::MutexLock lock(mutex_);
  drivers_[version] = {stamp, driver};
  return driver;
} catch (const config::Error&) {
  return {};
}

std::vector<discovery::KnownPlugin> PluginSource::all(const std::map<std::string, std::string>& names) {
  constexpr std::size_t most = 500;                           // plugins in an answer
  constexpr std::size_t most_text = std::size_t{512} * 1024;  // bytes of all declarations in an answer
  std::vector<discovery::KnownPlugin> plugins;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder_, error)) {
    if (entry.path().extension() != ".so" || !entry.is_regular_file(error)) continue;
    HostOrder order;
    order.plugin = entry.path().filename();
    plugins.push_back(known(entry.path(), entry.path().string() + ".sig", order));
  }
  for (const auto& sha256 : store_ ? store_->all() : std::vector<std::string>{}) {
    const auto path = store_->path_of(sha256);
    if (!path) continue;
    HostOrder order;
    const auto name = names.find(sha256);
    if (name != names.end()) order.plugin = name->second;
    order.sha256 = sha256;
    plugins.push_back(known(*path, store_->signature_path_of(sha256), order));
  }
  std::sort(plugins.begin(), plugins.end(),
            [](const auto& a, const auto& b) { return std::tie(a.file, a.sha256) < std::tie(b.file, b.sha256); });
  if (plugins.size() > most) plugins.resize(most);
  std::size_t text = 0;
  for (auto& plugin : plugins) {
    text += plugin.declaration.size();
    if (text > most_text) plugin.declaration.clear();
  }
  return plugins;
}

/// \param order names the plugin, and says whether it was sent.
discovery::KnownPlugin PluginSource::known(const std::string& path, const std::string& signature_path,
                                           const HostOrder& order) {
  discovery::KnownPlugin plugin;
  plugin.file = order.plugin;
  plugin.sent = !order.sha256.empty();
  plugin.sha256 = order.sha256;
  try {
    const Examined found = examine(path, signature_path, order);
    plugin.sha256 = found.identity.sha256;
    plugin.signed_by = found.identity.signed_by;
    plugin.signed_version = static_cast<std::int64_t>(found.signature.version);
    plugin.size = found.size;
    plugin.declaration = found.declaration;
  } catch (const config::Error& e) {
    plugin.problem = e.what();
  }
  return plugin;
}

PluginSource::Examined PluginSource::examine(const std::string& path, const std::string& signature_path,
                                             const HostOrder& order) {
  const auto signature_stamp = config::stamp_of(signature_path);
  const Basis basis{config::stamp_of(path), signature_stamp, trust_->generation()};
  {
    const config::MutexLock lock(mutex_);
    const auto known = examined_.find(path);
    if (known != examined_.end() && known->second.first == basis) return known->second.second;
  }
  const std::string content = processes::read_file(path, 0);
  Examined found;
  PluginIdentity& identity = found.identity;
  identity.sha256 = security::sha256_hex(content);
  found.size = static_cast<std::int64_t>(content.size());
  if (!order.sha256.empty() && identity.sha256 != order.sha256)
    throw config::Error(
        fmt::format("{}: it was sent with the SHA-256 {}, but {} has another now; send it again: iotcloud "
                    "update --plugin ./{} ID",
                    order.plugin, security::short_sha256(order.sha256), path, order.plugin));
  const std::string signature = signature_stamp == config::FileStamp{} ? "" : processes::read_file(signature_path, 0);
  identity.signed_by = trust_folder_ && order.sha256.empty() ? trust_->signer(content, signature)
                                                             : trust_->admit(order.plugin, content, signature);
  if (!identity.signed_by.empty()) found.signature = security::parse_plugin_signature(signature);
  // What the plugin says of itself is read once its signature, if one is required, is known to be good.
  const auto declaration = config::declaration_in(content);
  identity.driver = driver_name(declaration, order.plugin);
  found.declaration = config::to_json(declaration);
  found.isolated = content.find(IOTCLOUD_DRIVER_ISOLATION_MARK) != std::string::npos;
  const config::MutexLock lock(mutex_);
  examined_[path] = {basis, found};
  return found;
}

}  // namespace iotcloud::gateway
