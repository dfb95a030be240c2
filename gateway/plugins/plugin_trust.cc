#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>

#include <fmt/ranges.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/gateway/plugins/plugin_trust.h>

namespace iotcloud::gateway {

namespace fs = std::filesystem;

namespace {

const config::Logger log{"gateway"};

/// Whoever may write a key may say who is trusted.
void refuse_writable_by_others(const std::string& path) {
  struct stat status {};
  if (stat(path.c_str(), &status) != 0)
    throw config::Error(fmt::format("the trusted key {} cannot be read: {}", path, std::strerror(errno)));
  if ((status.st_mode & S_IWOTH) != 0)
    throw config::Error(fmt::format("anybody may change {}, which says whose plugins run; chmod o-w {}", path, path));
}

std::pair<std::string, config::PublicKey> read_key(const std::string& file) {
  refuse_writable_by_others(file);
  std::ifstream in(file, std::ios::binary);
  const std::string pem(std::istreambuf_iterator<char>(in), {});
  if (!in) throw config::Error(fmt::format("the trusted key {} cannot be read", file));
  return {fs::path(file).stem(), config::PublicKey::from_pem(pem, file)};
}

}  // namespace

PluginTrust::PluginTrust(const Options& options)
    : options_(options), keys_(std::make_shared<const Keys>(read(options.trusted_keys))) {
  if (options_.require_signature && keys_->empty())
    throw config::Error(
        "signatures are required, but no key is trusted, so no plugin could run; name the public keys of those who "
        "sign (`iotcloud keys new NAME` makes a pair)");
}

void PluginTrust::reload() {
  if (options_.trusted_keys.empty()) return;
  // A file that is named in the configuration and was taken away is a key that is gone; at the start it is a mistake.
  std::vector<std::string> there;
  std::copy_if(options_.trusted_keys.begin(), options_.trusted_keys.end(), std::back_inserter(there),
               [](const auto& path) {
                 std::error_code unreadable;  // read() says so
                 return fs::status(path, unreadable).type() != fs::file_type::not_found;
               });
  auto keys = std::make_shared<const Keys>(read(there));
  std::vector<std::string> names;
  for (const auto& [name, key] : *keys) names.push_back(name);
  log.info("trusted keys: {}", names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", ")));
  if (options_.require_signature && names.empty())
    log.warn("signatures are required, but no key is trusted any more, so no plugin starts; see plugins.trusted_keys");
  const std::lock_guard lock(mutex_);
  keys_ = std::move(keys);
  ++generation_;
}

std::uint64_t PluginTrust::generation() const {
  const std::lock_guard lock(mutex_);
  return generation_;
}

std::shared_ptr<const PluginTrust::Keys> PluginTrust::keys() const {
  const std::lock_guard lock(mutex_);
  return keys_;
}

PluginTrust::Keys PluginTrust::read(const std::vector<std::string>& paths) try {
  Keys keys;
  for (const auto& path : paths) {
    refuse_writable_by_others(path);
    if (!fs::is_directory(path)) {
      keys.push_back(read_key(path));
      continue;
    }
    std::vector<std::string> files;
    for (const auto& file : fs::directory_iterator(path)) {
      const auto extension = file.path().extension();
      if (extension == ".pub" || extension == ".pem") files.push_back(file.path());
    }
    std::sort(files.begin(), files.end());
    for (const auto& file : files) keys.push_back(read_key(file));
  }
  return keys;
} catch (const fs::filesystem_error& e) {
  throw config::Error(fmt::format("the trusted keys cannot be read: {}", e.what()));
}

std::string PluginTrust::signer(std::string_view content, std::string_view signature) const {
  if (signature.empty()) return "";
  const auto all = keys();
  for (const auto& [name, key] : *all) {
    if (key.verifies(content, signature)) return name;
  }
  return "";
}

std::string PluginTrust::admit(const std::string& what, std::string_view content, std::string_view signature) const {
  auto name = signer(content, signature);
  if (!requires_signature() || !name.empty()) return name;
  if (signature.empty())
    throw config::Error(fmt::format(
        "{} is not signed, and this gateway runs signed plugins only; sign it with `iotcloud sign FILE --key "
        "KEY` and keep FILE.sig beside it",
        what));
  throw config::Error(fmt::format(
      "{}: its signature is not one of these bytes by a key that this gateway trusts; either it was changed "
      "after it was signed (sign it again), or plugins.trusted_keys lacks the signer's public key",
      what));
}

}  // namespace iotcloud::gateway
