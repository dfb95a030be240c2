#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/signing/sha256.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/plugins/durable_file.h>
#include <iotcloud/gateway/plugins/plugin_store.h>

namespace iotcloud::gateway {

namespace fs = std::filesystem;
using config::Clock;

namespace {

constexpr config::Logger log{"gateway.plugins"};
constexpr const char* content_name = "plugin.so";
constexpr const char* signature_name = "signature";
constexpr mode_t only_to_read = S_IRUSR | S_IRGRP | S_IROTH;  // driver hosts may run as another user
constexpr auto written_by_owner = fs::perms::owner_all | fs::perms::group_read | fs::perms::group_exec |
                                  fs::perms::others_read | fs::perms::others_exec;

/// One that is not there is not signed.
std::string signature_in(const std::string& folder) {
  const std::string path = folder + "/" + signature_name;
  return fs::exists(path) ? read_file(path, config::signature_bytes) : "";
}

void write_signature(const std::string& path, const std::string& signature) {
  const auto file = create_file(path);
  write_all(file, signature, path);
  sync_file(file, path);
}

void remove_quietly(const std::string& path) noexcept {
  std::error_code error;
  fs::remove_all(path, error);
  if (error) log.warn("{} cannot be removed: {}", path, error.message());
}

/// One that is under way.
struct Upload {
  Upload(PluginStore::Offer what, std::string where) : offer(std::move(what)), folder(std::move(where)) {
    fs::create_directory(folder);
    fs::permissions(folder, written_by_owner);
    file = create_file(path());
  }
  ~Upload() { remove_quietly(folder); }  // once it has got its name there is nothing here any more
  Upload(const Upload&) = delete;
  Upload& operator=(const Upload&) = delete;
  std::string path() const { return folder + "/" + content_name; }

  const PluginStore::Offer offer;
  const std::string folder;
  Clock::Instant last;  ///< guarded by the store's mutex

  std::mutex mutex;
  OwnedDescriptor file;       ///< guarded by mutex
  config::Sha256 sha;         ///< guarded by mutex
  std::int64_t received = 0;  ///< guarded by mutex
};

}  // namespace

struct PluginStore::Impl {
  explicit Impl(Options given)
      : options(std::move(given)),
        clock(options.clock != nullptr ? *options.clock : config::system_clock()),
        trust(options.trust ? options.trust : std::make_shared<const PluginTrust>()),
        new_upload_id(options.new_upload_id ? options.new_upload_id : discovery::new_instance_id) {}

  std::string kept(const std::string& sha256) const { return options.folder + "/" + sha256; }
  std::string incoming() const { return options.folder + "/incoming"; }

  void check(const Offer& offer) const;
  bool have(const Offer& offer);
  void renew_signature(const Offer& offer, const std::string& content);
  void keep(Upload& upload);
  std::shared_ptr<Upload> find(const std::string& id);
  void drop_idle(Clock::Instant now);
  void drop(const std::string& id);

  const Options options;
  const Clock& clock;
  const std::shared_ptr<const PluginTrust> trust;
  const std::function<std::string()> new_upload_id;
  mutable std::mutex mutex;
  std::map<std::string, std::shared_ptr<Upload>> uploads;  ///< guarded by mutex
  std::map<std::string, Clock::Instant> wanted;  ///< guarded by mutex: when a kept plugin was last of use to somebody
};

PluginStore::PluginStore(Options options) : impl_(std::make_unique<Impl>(std::move(options))) {
  try {
    fs::create_directories(impl_->options.folder);
    fs::permissions(impl_->options.folder, written_by_owner);  // who may write there may have code run
    fs::remove_all(impl_->incoming());
    fs::create_directory(impl_->incoming());
  } catch (const fs::filesystem_error& e) {
    throw config::Error(fmt::format("the folder for plugins that are sent cannot be used: {}", e.what()));
  }
}

PluginStore::~PluginStore() = default;

void PluginStore::Impl::check(const Offer& offer) const {
  check_plugin_file_name(offer.file);
  if (!config::is_sha256(offer.sha256))
    throw config::Error(fmt::format("{}: a SHA-256 has 64 hexadecimal digits in lower case", offer.file));
  if (offer.size < 1) throw config::Error(fmt::format("{} is empty", offer.file));
  if (offer.size > options.most_bytes)
    throw config::Error(
        fmt::format("{} has {} bytes; this gateway takes plugins of {} at most (plugins.upload_limit_mb)", offer.file,
                    offer.size, options.most_bytes));
  if (!offer.signature.empty() && offer.signature.size() != config::signature_bytes)
    throw config::Error(fmt::format("{}: its signature has {} bytes, an Ed25519 signature has {}", offer.file,
                                    offer.signature.size(), config::signature_bytes));
  if (offer.signature.empty() && trust->requires_signature()) trust->admit(offer.file, "", "");
}

std::string PluginStore::offer(const Offer& offer) try {
  auto& self = *impl_;
  self.check(offer);
  const auto now = self.clock.now();
  {
    const std::lock_guard lock(self.mutex);
    self.wanted[offer.sha256] = now;  // from now on it is not cleaned away
    self.drop_idle(now);
  }
  if (self.have(offer)) return "";
  const std::lock_guard lock(self.mutex);
  if (static_cast<int>(self.uploads.size()) >= self.options.most_uploads)
    throw config::Error(
        fmt::format("this gateway takes {} plugins at a time; try again in a moment", self.options.most_uploads));
  std::string id = self.new_upload_id();
  auto upload = std::make_shared<Upload>(offer, self.incoming() + "/" + id);
  upload->last = now;
  self.uploads[id] = std::move(upload);
  return id;
} catch (const fs::filesystem_error& e) {
  throw config::Error(fmt::format("{} cannot be taken: {}", offer.file, e.what()));
}

/// Whether it is here, whole; then its signature is the better one of both afterwards.
bool PluginStore::Impl::have(const Offer& offer) {
  const std::string folder = kept(offer.sha256);
  if (!fs::exists(folder)) return false;
  std::string content;
  try {
    content = read_file(folder + "/" + content_name, 0);
  } catch (const config::Error& e) {
    log.warn("a kept plugin cannot be read: {}", e.what());
  }
  if (config::sha256_hex(content) != offer.sha256) {
    log.warn("{} is damaged, it is taken anew", folder);
    remove_quietly(folder);
    return false;
  }
  renew_signature(offer, content);
  return true;
}

void PluginStore::Impl::renew_signature(const Offer& offer, const std::string& content) {
  const std::string folder = kept(offer.sha256);
  const std::string before = signature_in(folder);
  if (!offer.signature.empty() && offer.signature != before && trust->signer(content, before).empty()) {
    trust->admit(offer.file, content, offer.signature);
    const std::string fresh = fmt::format("{}/{}.{}", folder, signature_name, discovery::new_instance_id());
    write_signature(fresh, offer.signature);
    fs::rename(fresh, folder + "/" + signature_name);
    sync_folder(folder);
    return;
  }
  trust->admit(offer.file, content, before);
}

std::shared_ptr<Upload> PluginStore::Impl::find(const std::string& id) {
  const std::lock_guard lock(mutex);
  const auto found = uploads.find(id);
  if (found == uploads.end())
    throw config::Error(
        "there is no such upload (any more); one that nobody goes on with ends after a while, and so does "
        "every one when the gateway ends: send the plugin again");
  found->second->last = clock.now();
  return found->second;
}

void PluginStore::Impl::drop(const std::string& id) {
  std::shared_ptr<Upload> last;  // its folder is removed without the lock
  const std::lock_guard lock(mutex);
  const auto found = uploads.find(id);
  if (found == uploads.end()) return;
  last = std::move(found->second);
  uploads.erase(found);
}

void PluginStore::add(const std::string& id, std::int64_t offset, std::string_view bytes) {
  const auto upload = impl_->find(id);
  try {
    const std::lock_guard lock(upload->mutex);
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
  try {
    const std::lock_guard lock(upload->mutex);
    impl_->keep(*upload);
  } catch (const fs::filesystem_error& e) {
    throw config::Error(fmt::format("{} cannot be kept: {}", upload->offer.file, e.what()));
  }
  {
    const std::lock_guard lock(impl_->mutex);
    impl_->wanted[upload->offer.sha256] = impl_->clock.now();
  }
  log.info("keeps the plugin {} ({} bytes, SHA-256 {})", upload->offer.file, upload->offer.size, upload->offer.sha256);
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
  sync_folder(upload.folder);
  const std::string place = kept(offer.sha256);
  if (std::rename(upload.folder.c_str(), place.c_str()) != 0) {
    if (errno != ENOTEMPTY && errno != EEXIST)
      throw config::Error(fmt::format("{} cannot be kept as {}: {}", offer.file, place, std::strerror(errno)));
    have(offer);  // another upload of the same was faster
  }
  sync_folder(options.folder);
}

std::string PluginStore::path_of(const std::string& sha256, const std::string& file) const {
  std::string path = impl_->kept(sha256) + "/" + content_name;
  if (config::is_sha256(sha256) && fs::exists(path)) return path;
  throw config::Error(
      fmt::format("the plugin {} (SHA-256 {}) is not on this gateway; send it again: iotcloud update --plugin ./{} ID",
                  file, config::short_sha256(sha256), file));
}

std::string PluginStore::signature_path_of(const std::string& sha256) const {
  return impl_->kept(sha256) + "/" + signature_name;
}

void PluginStore::Impl::drop_idle(Clock::Instant now) {
  std::erase_if(uploads, [&](const auto& entry) {
    if (now - entry.second->last < options.idle_limit) return false;
    log.warn("the upload of {} ends: nobody goes on with it", entry.second->offer.file);
    return true;
  });
}

void PluginStore::clean(const std::set<std::string>& named) {
  auto& self = *impl_;
  const auto now = self.clock.now();
  const std::lock_guard lock(self.mutex);
  self.drop_idle(now);
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(self.options.folder, error)) {
    const std::string sha256 = entry.path().filename();
    if (!config::is_sha256(sha256)) continue;
    if (named.contains(sha256)) self.wanted[sha256] = now;
    const auto since = self.wanted.emplace(sha256, now).first->second;
    if (now - since < self.options.unnamed_limit) continue;
    log.info("removes the plugin with the SHA-256 {}: no order names it any more", sha256);
    remove_quietly(entry.path());
  }
  std::erase_if(self.wanted, [&](const auto& one) { return now - one.second >= self.options.unnamed_limit; });
  if (error) log.warn("{} cannot be read: {}", self.options.folder, error.message());
}

int PluginStore::uploads() const {
  const std::lock_guard lock(impl_->mutex);
  return static_cast<int>(impl_->uploads.size());
}

}  // namespace iotcloud::gateway
