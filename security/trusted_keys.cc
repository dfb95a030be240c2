#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>

#include <fmt/ranges.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/security/logger.h>
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/security/trusted_keys.h>

namespace iotcloud::security {

namespace fs = std::filesystem;

namespace {

/// Refuses a key that every user may write, because whoever can write it decides who is trusted.
void refuse_writable_by_others(const std::string& path) {
  struct stat status {};
  if (stat(path.c_str(), &status) != 0)
    throw config::Error(fmt::format("the trusted key {} cannot be read: {}", path, std::strerror(errno)));
  if ((status.st_mode & S_IWOTH) != 0)
    throw config::Error(fmt::format("anybody may change {}, which says whose plugins run; chmod o-w {}", path, path));
}

std::pair<std::string, PublicKey> read_key(const std::string& file) {
  refuse_writable_by_others(file);
  std::ifstream in(file, std::ios::binary);
  const std::string pem(std::istreambuf_iterator<char>(in), {});
  if (!in) throw config::Error(fmt::format("the trusted key {} cannot be read", file));
  return {fs::path(file).stem(), PublicKey::from_pem(pem, file)};
}

}  // namespace

TrustedKeys::TrustedKeys(const Options& options)
    : options_(options), keys_(std::make_shared<const Keys>(read(options.trusted_keys))) {
  if (options_.require_signature && keys_->empty())
    throw config::Error(
        "signatures are required, but no key is trusted, so no plugin could run; name the public keys of those who "
        "sign (`iotcloud keys new NAME` makes a pair)");
}

void TrustedKeys::reload() {
  if (options_.trusted_keys.empty()) return;
  // A configured key file that is missing now was removed on purpose, so its key is no longer trusted. At the start a
  // missing file is an error instead.
  std::vector<std::string> there;
  std::copy_if(options_.trusted_keys.begin(), options_.trusted_keys.end(), std::back_inserter(there),
               [](const auto& path) {
                 std::error_code unreadable;  // ignored here: read() reports it
                 return fs::status(path, unreadable).type() != fs::file_type::not_found;
               });
  auto keys = std::make_shared<const Keys>(read(there));
  std::vector<std::string> names;
  for (const auto& [name, key] : *keys) names.push_back(name);
  keys_logger.info("trusted keys: {}", names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", ")));
  if (options_.require_signature && names.empty())
    keys_logger.warn("signatures are required, but no key is trusted any more, so no plugin starts; see trusted_keys");
  const config::MutexLock lock(mutex_);
  keys_ = std::move(keys);
  ++generation_;
}

std::uint64_t TrustedKeys::generation() const {
  const config::MutexLock lock(mutex_);
  return generation_;
}

std::shared_ptr<const TrustedKeys::Keys> TrustedKeys::keys() const {
  const config::MutexLock lock(mutex_);
  return keys_;
}

TrustedKeys::Keys TrustedKeys::read(const std::vector<std::string>& paths) try {
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

std::string TrustedKeys::signer(std::string_view content, std::string_view signature) const {
  if (signature.empty()) return "";
  const auto parts = parse_plugin_signature(signature);
  std::string with_head;
  if (!parts.head.empty()) with_head.append(parts.head).append(content);
  const auto all = keys();
  for (const auto& [name, key] : *all) {
    if (key.verifies(parts.head.empty() ? content : std::string_view(with_head), parts.bytes)) return name;
  }
  return "";
}

std::string TrustedKeys::admit(const std::string& what, std::string_view content, std::string_view signature) const {
  auto name = signer(content, signature);
  if (!requires_signature() || !name.empty()) return name;
  if (signature.empty())
    throw config::Error(
        fmt::format("{} is not signed, and only signed plugins run here; sign it with `iotcloud sign FILE --key "
                    "KEY` and keep FILE.sig beside it",
                    what));
  throw config::Error(
      fmt::format("{}: its signature is not one of these bytes by a key that is trusted here; either it was changed "
                  "after it was signed (sign it again), or trusted_keys lacks the signer's public key",
                  what));
}

std::shared_ptr<TrustedKeys> read_signers(config::YamlSection& file, const std::string& prefix) {
  TrustedKeys::Options options;
  options.require_signature = file.bool_or(prefix + ".require_signature", false);
  options.trusted_keys = file.strings_or(prefix + ".trusted_keys", {});
  std::shared_ptr<TrustedKeys> keys;
  file.check(prefix + (options.trusted_keys.empty() ? ".require_signature" : ".trusted_keys"),
             [&] { keys = std::make_shared<TrustedKeys>(options); });
  return keys;
}

bool read_require_version(config::YamlSection& file, const std::string& prefix, const TrustedKeys* signers) {
  const std::string key = prefix + ".require_version";
  const bool required = file.bool_or(key, false);
  if (required && signers != nullptr && !signers->requires_signature()) {
    file.refuse(key, fmt::format("versions are in signatures, which {} need not have here", prefix),
                fmt::format("{0}.require_signature: true, with {0}.trusted_keys", prefix));
  }
  return required;
}

std::shared_ptr<TrustedKeys> read_trusted_masters(config::YamlSection& file) {
  TrustedKeys::Options options{true, file.strings_or("orders.trusted_keys", {})};
  if (options.trusted_keys.empty()) return nullptr;
  std::shared_ptr<TrustedKeys> keys;
  file.check("orders.trusted_keys", [&] { keys = std::make_shared<TrustedKeys>(options); });
  return keys;
}

}  // namespace iotcloud::security
