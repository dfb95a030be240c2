#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/security/logger.h>
#include <iotcloud/security/plugin_versions.h>

namespace iotcloud::security {

namespace {

constexpr unsigned for_this_daemon = 0600;

}  // namespace

PluginVersions::PluginVersions(Options options, const config::Clock& clock)
    : options_(std::move(options)), clock_(clock) {
  if (!std::filesystem::exists(options_.file)) return;
  std::ifstream in(options_.file);
  const config::MutexLock lock(mutex_);
  for (std::string line; std::getline(in, line);) {
    std::istringstream words(line);
    std::string name;
    Known known;
    if (!(words >> name >> known.newest >> known.before >> known.since_ms)) {
      throw config::Error(fmt::format(
          "{} is damaged at \"{}\": each line has a plugin's name, its newest version, the one before, and a time",
          options_.file, line));
    }
    known_[name] = known;
  }
}

bool PluginVersions::may_go_back(const std::string& name) const {
  const auto& names = options_.allow_rollback;
  return std::find(names.begin(), names.end(), name) != names.end();
}

void PluginVersions::refuse_without_version(const std::string& plugin) const {
  const std::string name = plugin.substr(0, plugin.rfind('.'));
  const auto known = known_.find(name);
  if (may_go_back(name) || (!options_.require_version && known == known_.end())) return;
  throw VersionRefused(fmt::format(
      "{} was signed without a version{}; sign it with `iotcloud sign --version N`, or name {} in {}.allow_rollback",
      plugin, known == known_.end() ? "" : fmt::format(", and version {} of it ran here", known->second.newest), name,
      options_.keys));
}

PluginVersions::Known PluginVersions::known(const std::string& name) const {
  const auto found = known_.find(name);
  return found == known_.end() ? Known{} : found->second;
}

void PluginVersions::learn(const PluginSignature& signature, bool of_update) {
  AllKnown next = known_;
  Known& fresh = next[signature.name];
  fresh = {signature.version, fresh.newest, of_update ? clock_.wall_ms() : 0};
  writing_ = true;
  try {
    const config::Unlocked unlocked(mutex_);  // a version that ran before does not wait for the disk
    write(next);
  } catch (...) {  // what is not written down is not known: the next try writes it
    writing_ = false;
    written_.notify_all();
    throw;
  }
  known_ = std::move(next);
  writing_ = false;
  written_.notify_all();
}

void PluginVersions::admit(const std::string& plugin, const PluginSignature& signature, bool of_update) {
  const config::MutexLock lock(mutex_);
  if (signature.version == 0) return refuse_without_version(plugin);
  while (signature.version > known(signature.name).newest) {
    if (!writing_) return learn(signature, of_update);
    written_.wait(mutex_);
  }
  const Known known = this->known(signature.name);
  if (signature.version == known.newest) return;
  const bool goes_back = signature.version == known.before && known.since_ms != 0;
  if (goes_back && clock_.wall_ms() - known.since_ms < options_.way_back.count()) return;
  if (may_go_back(signature.name)) {
    keys_logger.warn("{}: version {} runs although version {} ran here, as {}.allow_rollback says", plugin,
                     signature.version, known.newest, options_.keys);
    return;
  }
  throw VersionRefused(
      fmt::format("{}: version {} of {} is older than version {}, which ran here, and may have holes that were mended "
                  "since; deploy a newer one, or name {} in {}.allow_rollback",
                  plugin, signature.version, signature.name, known.newest, signature.name, options_.keys));
}

void PluginVersions::write(const AllKnown& known) const {
  std::string text;
  for (const auto& [name, one] : known)
    text += fmt::format("{} {} {} {}\n", name, one.newest, one.before, one.since_ms);
  config::replace_file(options_.file, text, for_this_daemon);
}

}  // namespace iotcloud::security
