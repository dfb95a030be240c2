#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <sys/stat.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/processes/logger.h>
#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/processes/random_name.h>
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::processes {

namespace fs = std::filesystem;
using config::Clock;

namespace {

constexpr const char* content_name = "plugin.so";
constexpr const char* signature_name = "signature";
constexpr mode_t only_to_read = S_IRUSR | S_IRGRP | S_IROTH;  // driver hosts may run as another user
constexpr auto written_by_owner = fs::perms::owner_all | fs::perms::group_read | fs::perms::group_exec |
                                  fs::perms::others_read | fs::perms::others_exec;

/// Reads the plugin's signature; empty if there is no file.
std::string signature_in(const std::string& folder) {
  const std::string path = folder + "/" + signature_name;
  return fs::exists(path) ? read_file(path, security::most_plugin_signature_bytes) : "";
}

void write_signature(const std::string& path, const std::string& signature) {
  const auto file = create_file(path);
  write_all(file, signature, path);
  sync_file(file, path);
}

void remove_quietly(const std::string& path) noexcept {
  std::error_code error;
  fs::remove_all(path, error);
  if (error) logger.warn("{} cannot be removed: {}", path, error.message());
}

/// An upload in progress.
struct Upload {
  Upload(PluginStore::Offer what, std::string where) : offer(std::move(what)), folder(std::move(where)) {
    fs::create_directory(folder);
    fs::permissions(folder, written_by_owner);
    file = create_file(path());
  }
  ~Upload() { remove_quietly(folder); }  // a finished upload has been renamed, so there is nothing left to remove
  Upload(const Upload&) = delete;
  Upload& operator=(const Upload&) = delete;
  std::string path() const { return folder + "/" + content_name; }

  const PluginStore::Offer offer;
  const std::string folder;

  /// Each upload has its own mutex, held while bytes are written, so that other uploads do not wait.
  config::Mutex mutex;
  OwnedDescriptor file IOTCLOUD_GUARDED_BY(mutex);
  security::Sha256 sha IOTCLOUD_GUARDED_BY(mutex);
  std::int64_t received IOTCLOUD_GUARDED_BY(mutex) = 0;
};

struct KnownUpload {
  std::shared_ptr<Upload> upload;
  Clock::Instant last;  ///< when somebody last called add() or finish() for it
};

}  // namespace

struct PluginStore::Impl {
  explicit Impl(Options given)
      : options(std::move(given)),
        clock(options.clock != nullptr ? *options.clock : config::system_clock()),
        trust(options.trust ? options.trust : std::make_shared<const security::TrustedKeys>()),
        new_upload_id(options.new_upload_id ? options.new_upload_id : random_name),
        remove_folder(options.remove_folder ? options.remove_folder : remove_quietly) {}

  std::string kept(const std::string& sha256) const { return options.folder + "/" + sha256; }
  std::string incoming() const { return options.folder + "/incoming"; }

  void check(const Offer& offer) const;
  bool have(const Offer& offer);
  void renew_signature(const Offer& offer, const std::string& content);
  bool is_better(const std::string& signature, const std::string& before, const std::string& content) const;
  void keep(Upload& upload) IOTCLOUD_REQUIRES(upload.mutex);
  std::shared_ptr<Upload> find(const std::string& id);
  void want(const std::string& sha256);
  void drop_idle(Clock::Instant now);
  std::vector<std::string> take_unwanted(const std::vector<std::string>& kept, const std::set<std::string>& named);
  void drop(const std::string& id);

  const Options options;
  const Clock& clock;
  const std::shared_ptr<const security::TrustedKeys> trust;
  const std::function<std::string()> new_upload_id;
  const std::function<void(const std::string&)> remove_folder;
  /// Never held during file operations.
  mutable config::Mutex mutex;
  config::ConditionVariable removed;
  std::map<std::string, KnownUpload> uploads IOTCLOUD_GUARDED_BY(mutex);
  /// when each kept plugin was last offered or named by an order
  std::map<std::string, Clock::Instant> wanted IOTCLOUD_GUARDED_BY(mutex);
  std::set<std::string> going IOTCLOUD_GUARDED_BY(mutex);  ///< kept plugins that are being removed
  int beginning IOTCLOUD_GUARDED_BY(mutex) = 0;            ///< uploads whose files are being made
};

PluginStore::PluginStore(Options options) : impl_(std::make_unique<Impl>(std::move(options))) {
  try {
    fs::create_directories(impl_->options.folder);
    fs::permissions(impl_->options.folder, written_by_owner);  // whoever may write there can have code run
    fs::remove_all(impl_->incoming());
    fs::create_directory(impl_->incoming());
  } catch (const fs::filesystem_error& e) {
    throw config::Error(fmt::format("the folder for plugins that are sent cannot be used: {}", e.what()));
  }
}

PluginStore::~PluginStore() = default;

void PluginStore::Impl::check(const Offer& offer) const {
  if (!is_plain_file_name(offer.file)) throw config::Error(fmt::format("\"{}\" is not a plain file name", offer.file));
  if (!security::is_sha256(offer.sha256))
    throw config::Error(fmt::format("{}: a SHA-256 has 64 hexadecimal digits in lower case", offer.file));
  if (offer.size < 1) throw config::Error(fmt::format("{} is empty", offer.file));
  if (offer.size > options.most_bytes)
    throw config::Error(fmt::format("{} has {} bytes; files of {} at most are taken here ({})", offer.file, offer.size,
                                    options.most_bytes, options.limit_key));
  if (!offer.signature.empty() && !security::is_plugin_signature(offer.signature))
    throw config::Error(
        fmt::format("{}: its signature has {} bytes, an Ed25519 signature has {}, after a line with name "
                    "and version if there is one",
                    offer.file, offer.signature.size(), security::signature_bytes));
  if (offer.signature.empty() && trust->requires_signature()) trust->admit(offer.file, "", "");
}

std::string PluginStore::offer(const Offer& offer) try {
  auto& self = *impl_;
  self.check(offer);
  const auto now = self.clock.now();
  self.want(offer.sha256);
  self.drop_idle(now);
  if (self.have(offer)) return "";
  {
    const config::MutexLock lock(self.mutex);
    if (static_cast<int>(self.uploads.size()) + self.beginning >= self.options.most_uploads)
      throw config::Error(
          fmt::format("only {} plugins are taken at a time here; try again in a moment", self.options.most_uploads));
    ++self.beginning;
  }
  std::string id;
  std::shared_ptr<Upload> upload;
  try {
    id = self.new_upload_id();
    upload = std::make_shared<Upload>(offer, self.incoming() + "/" + id);
  } catch (...) {
    const config::MutexLock lock(self.mutex);
    --self.beginning;
    throw;
  }
  const config::MutexLock lock(self.mutex);
  --self.beginning;
  self.uploads[id] = {std::move(upload), now};
  return id;
} catch (const fs::filesystem_error& e) {
  throw config::Error(fmt::format("{} cannot be taken: {}", offer.file, e.what()));
}

/// Notes that the plugin is needed, so that clean() keeps it for `unnamed_limit`.
void PluginStore::Impl::want(const std::string& sha256) {
  const config::MutexLock lock(mutex);
  while (going.contains(sha256)) removed.wait(mutex);
  wanted[sha256] = clock.now();
}

/// Whether the store has the complete plugin; a damaged copy is removed. If only the offered signature is trusted, it
/// replaces the stored one.
bool PluginStore::Impl::have(const Offer& offer) {
  const std::string folder = kept(offer.sha256);
  if (!fs::exists(folder)) return false;
  std::string content;
  try {
    content = read_file(folder + "/" + content_name, 0);
  } catch (const config::Error& e) {
    logger.warn("a kept plugin cannot be read: {}", e.what());
  }
  if (security::sha256_hex(content) != offer.sha256) {
    logger.warn("{} is damaged, it is taken anew", folder);
    remove_quietly(folder);
    return false;
  }
  renew_signature(offer, content);
  return true;
}

/// Whether the signature of a plugin that is there already replaces the one before.
bool PluginStore::Impl::is_better(const std::string& signature, const std::string& before,
                                  const std::string& content) const {
  if (trust->signer(content, before).empty()) return true;
  return !trust->signer(content, signature).empty() &&
         security::parse_plugin_signature(signature).version > security::parse_plugin_signature(before).version;
}

void PluginStore::Impl::renew_signature(const Offer& offer, const std::string& content) {
  const std::string folder = kept(offer.sha256);
  const std::string before = signature_in(folder);
  if (!offer.signature.empty() && offer.signature != before && is_better(offer.signature, before, content)) {
    trust->admit(offer.file, content, offer.signature);
    const std::string fresh = fmt::format("{}/{}.{}", folder, signature_name, random_name());
    write_signature(fresh, offer.signature);
    fs::rename(fresh, folder + "/" + signature_name);
    config::sync_folder(folder);
    return;
  }
  trust->admit(offer.file, content, before);
}

std::shared_ptr<Upload> PluginStore::Impl::find(const std::string& id) {
  const config::MutexLock lock(mutex);
  const auto found = uploads.find(id);
  if (found == uploads.end())
    throw config::Error(
        "there is no such upload (any more); one that nobody goes on with ends after a while, and so does "
        "every one when the process ends: send the plugin again");
  found->second.last = clock.now();
  return found->second.upload;
}

void PluginStore::Impl::drop(const std::string& id) {
  std::shared_ptr<Upload> last;  // declared before the lock, so that the upload's folder is removed without it
  const config::MutexLock lock(mutex);
  const auto found = uploads.find(id);
  if (found == uploads.end()) return;
  last = std::move(found->second.upload);
  uploads.erase(found);
}

void PluginStore::add(const std::string& id, std::int64_t offset, std::string_view bytes) {
  const auto upload = impl_->find(id);
  try {
    const config::MutexLock lock(upload->mutex);
    if (offset != upload->received)
      throw config::Error(fmt::format("{}: bytes from {} on came, but those from {} on are next; send the plugin again",
                                      upload->offer.file, offset, upload->received));
    if (static_cast<std::int64_t>(bytes.size()) > upload->offer.size - upload->received)
      throw config::Error(fmt::format("{}: more bytes came than the {} that were offered; send the plugin again",
                                      upload->offer.file, upload->offer.size));
    write_all(upload->file, bytes, upload->path());
    upload->sha.add(bytes);
    upload->received += static_cast<std::int64_t>(bytes.size());
  } catch (const config::Error&) {
    impl_->drop(id);
    throw;
  }
}

void PluginStore::finish(const std::string& id) {
  const auto upload = impl_->find(id);
  impl_->drop(id);
  impl_->want(upload->offer.sha256);
  try {
    const config::MutexLock lock(upload->mutex);
    impl_->keep(*upload);
  } catch (const fs::filesystem_error& e) {
    throw config::Error(fmt::format("{} cannot be kept: {}", upload->offer.file, e.what()));
  }
  logger.info("keeps the plugin {} ({} bytes, SHA-256 {})", upload->offer.file, upload->offer.size,
              upload->offer.sha256);
}

void PluginStore::Impl::keep(Upload& upload) {
  const auto& offer = upload.offer;
  if (upload.received != offer.size)
    throw config::Error(
        fmt::format("{}: {} of {} bytes came; send the plugin again", offer.file, upload.received, offer.size));
  if (const auto sha = upload.sha.hex(); sha != offer.sha256)
    throw config::Error(fmt::format("{}: the bytes that came have the SHA-256 {}, not {}; send the plugin again",
                                    offer.file, sha, offer.sha256));
  if (!offer.signature.empty()) trust->admit(offer.file, read_file(upload.path(), 0), offer.signature);
  sync_file(upload.file, upload.path());
  upload.file.reset();
  chmod(upload.path().c_str(), only_to_read);
  if (!offer.signature.empty()) write_signature(upload.folder + "/" + signature_name, offer.signature);
  config::sync_folder(upload.folder);
  const std::string place = kept(offer.sha256);
  if (std::rename(upload.folder.c_str(), place.c_str()) != 0) {
    if (errno != ENOTEMPTY && errno != EEXIST)
      throw config::Error(fmt::format("{} cannot be kept as {}: {}", offer.file, place, std::strerror(errno)));
    have(offer);  // another upload of the same plugin has finished first
  }
  config::sync_folder(options.folder);
}

std::optional<std::string> PluginStore::path_of(const std::string& sha256) const {
  if (!security::is_sha256(sha256)) return std::nullopt;
  std::string path = impl_->kept(sha256) + "/" + content_name;
  if (!fs::exists(path)) return std::nullopt;
  return path;
}

std::string PluginStore::signature_path_of(const std::string& sha256) const {
  return impl_->kept(sha256) + "/" + signature_name;
}

void PluginStore::Impl::drop_idle(Clock::Instant now) {
  // Declared before the lock, so that the uploads' folders are removed without it.
  std::vector<std::shared_ptr<Upload>> idle;
  {
    const config::MutexLock lock(mutex);
    std::erase_if(uploads, [&](auto& entry) {
      if (now - entry.second.last < options.idle_limit) return false;
      idle.push_back(std::move(entry.second.upload));
      return true;
    });
  }
  for (const auto& upload : idle) logger.warn("the upload of {} ends: nobody goes on with it", upload->offer.file);
}

/// Finds the kept plugins that no order has named for `unnamed_limit`, and marks them as `going`. \return their SHA-256
std::vector<std::string> PluginStore::Impl::take_unwanted(const std::vector<std::string>& kept,
                                                          const std::set<std::string>& named) {
  std::vector<std::string> unwanted;
  const auto now = clock.now();
  const config::MutexLock lock(mutex);
  for (const std::string& sha256 : kept) {
    if (named.contains(sha256)) wanted[sha256] = now;
    const auto since = wanted.emplace(sha256, now).first->second;
    if (now - since >= options.unnamed_limit && going.insert(sha256).second) unwanted.push_back(sha256);
  }
  std::erase_if(wanted, [&](const auto& one) { return now - one.second >= options.unnamed_limit; });
  return unwanted;
}

std::vector<std::string> PluginStore::all() const {
  std::vector<std::string> kept;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(impl_->options.folder, error)) {
    std::string sha256 = entry.path().filename();
    if (security::is_sha256(sha256)) kept.push_back(std::move(sha256));
  }
  if (error) logger.warn("{} cannot be read: {}", impl_->options.folder, error.message());
  return kept;
}

void PluginStore::clean(const std::set<std::string>& named) {
  auto& self = *impl_;
  self.drop_idle(self.clock.now());
  for (const std::string& sha256 : self.take_unwanted(all(), named)) {
    logger.info("removes the plugin with the SHA-256 {}: no order names it any more", sha256);
    self.remove_folder(self.kept(sha256));
    {
      const config::MutexLock lock(self.mutex);
      self.going.erase(sha256);
    }
    self.removed.notify_all();
  }
}

int PluginStore::uploads() const {
  const config::MutexLock lock(impl_->mutex);
  return static_cast<int>(impl_->uploads.size());
}

bool is_plain_file_name(const std::string& name) {
  return !name.empty() && name != "." && name != ".." &&
         std::none_of(name.begin(), name.end(), [](unsigned char c) { return c == '/' || c < 0x20 || c == 0x7f; });
}

}  // namespace iotcloud::processes
