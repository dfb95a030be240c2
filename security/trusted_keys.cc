#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stop_token>
#include <system_error>
#include <utility>

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

/// Whether there is nothing at this path. What cannot be reached may be there.
bool is_gone(const std::string& path) {
  std::error_code unreachable;
  return fs::status(path, unreachable).type() == fs::file_type::not_found;
}

/// The file itself, or those in the folder that are keys, in the order of their names.
std::vector<std::string> key_files(const std::string& path, std::error_code& error) {
  if (!fs::is_directory(path, error)) return {path};
  std::vector<std::string> files;
  for (auto file = fs::directory_iterator(path, error); !error && file != fs::directory_iterator();
       file.increment(error)) {
    const auto extension = file->path().extension();
    if (extension == ".pub" || extension == ".pem") files.push_back(file->path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

PublicKey read_trusted_key(const std::string& file) {
  refuse_writable_by_others(file);
  std::ifstream in(file, std::ios::binary);
  const std::string pem(std::istreambuf_iterator<char>(in), {});
  if (!in) throw config::Error(fmt::format("the trusted key {} cannot be read", file));
  return PublicKey::from_pem(pem, file);
}

}  // namespace

TrustedKeys::TrustedKeys(const Options& options, const config::Clock& clock)
    : options_(options),
      clock_(clock),
      seen_(stamps()),
      next_look_(clock.now() + look_period),
      keys_(std::make_shared<const Keys>(read(options.trusted_keys))) {
  if (options_.require_signature && keys_->empty())
    throw config::Error(
        "signatures are required, but no key is trusted, so no plugin could run; name the public keys of those who "
        "sign (`iotcloud keys new NAME` makes a pair)");
}

void TrustedKeys::reload() {
  if (options_.trusted_keys.empty()) return;
  const config::MutexLock lock(reading_);
  read_again();
}

/// Reads the keys if one of their files or folders was changed since they were last read.
void TrustedKeys::look() const {
  if (options_.trusted_keys.empty()) return;
  const config::MutexLock lock(reading_);
  const auto now = clock_.now();
  if (now < next_look_) return;
  next_look_ = now + look_period;
  if (seen_ == stamps()) return;
  try {
    read_again();
  } catch (const config::Error& e) {
    keys_logger.error("the keys that were trusted before still are, but for those whose files are gone: {}", e.what());
  }
}

void TrustedKeys::read_again() const {
  // Before the files are read: look() notices one that is replaced meanwhile, and reads one that is of no use again
  // only when it has changed.
  seen_ = stamps();
  next_look_ = clock_.now() + look_period;
  // A configured key file that is missing now was removed on purpose, so its key is no longer trusted. At the start a
  // missing file is an error instead.
  std::vector<std::string> there;
  std::copy_if(options_.trusted_keys.begin(), options_.trusted_keys.end(), std::back_inserter(there),
               [](const auto& path) { return !is_gone(path); });
  try {
    trust(read(there));
  } catch (const config::Error&) {
    Keys before;
    {
      const config::MutexLock lock(mutex_);
      before = *keys_;
    }
    if (std::erase_if(before, [](const Key& key) { return is_gone(key.file); }) > 0) trust(std::move(before));
    throw;
  }
}

void TrustedKeys::trust(Keys keys) const {
  std::vector<std::string> names;
  for (const auto& key : keys) names.push_back(key.name);
  keys_logger.info("trusted keys: {}", names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", ")));
  if (options_.require_signature && names.empty())
    keys_logger.warn("signatures are required, but no key is trusted any more, so no plugin starts; see trusted_keys");
  const config::MutexLock lock(mutex_);
  keys_ = std::make_shared<const Keys>(std::move(keys));
  ++generation_;
}

std::uint64_t TrustedKeys::generation() const {
  look();
  const config::MutexLock lock(mutex_);
  return generation_;
}

std::jthread TrustedKeys::on_change(std::function<void()> changed) const {
  return std::jthread([this, changed = std::move(changed), seen = generation()](const std::stop_token& stop) mutable {
    config::Mutex mutex;
    config::StoppableConditionVariable end;
    const config::MutexLock lock(mutex);
    while (!end.wait_for(mutex, stop, look_period, [&] { return stop.stop_requested(); })) {
      const std::uint64_t now = generation();
      if (std::exchange(seen, now) != now) changed();
    }
  });
}

std::shared_ptr<const TrustedKeys::Keys> TrustedKeys::keys() const {
  look();
  const config::MutexLock lock(mutex_);
  return keys_;
}

TrustedKeys::Keys TrustedKeys::read(const std::vector<std::string>& paths) {
  Keys keys;
  for (const auto& path : paths) {
    refuse_writable_by_others(path);
    std::error_code error;
    const auto files = key_files(path, error);
    if (error) throw config::Error(fmt::format("the trusted keys in {} cannot be read: {}", path, error.message()));
    for (const auto& file : files) keys.push_back({fs::path(file).stem(), read_trusted_key(file), file});
  }
  return keys;
}

TrustedKeys::Stamps TrustedKeys::stamps() const {
  Stamps stamps;
  for (const auto& path : options_.trusted_keys) {
    stamps[path] = config::stamp_of(path);
    std::error_code unreadable;  // ignored here: read() reports it
    for (const auto& file : key_files(path, unreadable)) stamps[file] = config::stamp_of(file);
  }
  return stamps;
}

std::string TrustedKeys::signer(std::string_view content, std::string_view signature) const {
  if (signature.empty()) return "";
  const auto parts = parse_plugin_signature(signature);
  std::string with_head;
  if (!parts.head.empty()) with_head.append(parts.head).append(content);
  const auto all = keys();
  for (const auto& trusted : *all) {
    if (trusted.key.verifies(parts.head.empty() ? content : std::string_view(with_head), parts.bytes))
      return trusted.name;
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
