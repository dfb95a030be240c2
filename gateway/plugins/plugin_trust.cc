#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>

#include <fmt/format.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/plugins/plugin_trust.h>

namespace iotcloud::gateway {

namespace fs = std::filesystem;

namespace {

/// Whoever may write a key may say who is trusted.
void refuse_writable_by_others(const std::string& path) {
  struct stat status {};
  if (stat(path.c_str(), &status) != 0)
    throw config::Error(fmt::format("the trusted key {} cannot be read: {}", path, std::strerror(errno)));
  if ((status.st_mode & S_IWOTH) != 0)
    throw config::Error(fmt::format("anybody may change {}, which says whose plugins run; chmod o-w {}", path, path));
}

}  // namespace

PluginTrust::PluginTrust(const Options& options) try : required_(options.require_signature) {
  for (const auto& path : options.trusted_keys) {
    refuse_writable_by_others(path);
    if (!fs::is_directory(path)) {
      add(path);
      continue;
    }
    std::vector<std::string> files;
    for (const auto& file : fs::directory_iterator(path)) {
      const auto extension = file.path().extension();
      if (extension == ".pub" || extension == ".pem") files.push_back(file.path());
    }
    std::sort(files.begin(), files.end());
    for (const auto& file : files) add(file);
  }
  if (required_ && keys_.empty())
    throw config::Error(
        "signatures are required, but no key is trusted, so no plugin could run; name the public keys of those who "
        "sign "
        "(`iotcloud keys new NAME` makes a pair)");
} catch (const fs::filesystem_error& e) {
  throw config::Error(fmt::format("the trusted keys cannot be read: {}", e.what()));
}

void PluginTrust::add(const std::string& file) {
  refuse_writable_by_others(file);
  std::ifstream in(file, std::ios::binary);
  const std::string pem(std::istreambuf_iterator<char>(in), {});
  if (!in) throw config::Error(fmt::format("the trusted key {} cannot be read", file));
  keys_.emplace_back(fs::path(file).stem(), config::PublicKey::from_pem(pem, file));
}

std::string PluginTrust::signer(std::string_view content, std::string_view signature) const {
  if (signature.empty()) return "";
  for (const auto& [name, key] : keys_) {
    if (key.verifies(content, signature)) return name;
  }
  return "";
}

std::string PluginTrust::admit(const std::string& what, std::string_view content, std::string_view signature) const {
  auto name = signer(content, signature);
  if (!required_ || !name.empty()) return name;
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
