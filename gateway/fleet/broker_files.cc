#include <cerrno>
#include <cstring>
#include <filesystem>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <sys/stat.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/gateway/fleet/broker_files.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

namespace fs = std::filesystem;

namespace {

constexpr std::size_t most_bytes = std::size_t{1} << 20;

/// The same in every run, so that hosts which outlive a gateway find their files again.
std::string copy_of(const std::string& folder, const std::string& file) {
  return fmt::format("{}/{}-{}", folder, security::short_sha256(security::sha256_hex(file)),
                     fs::path(file).filename().string());
}

bool has_bytes(const std::string& file, const std::string& bytes) try {
  return processes::read_file(file, most_bytes) == bytes;
} catch (const config::Error&) {
  return false;
}

}  // namespace

BrokerFiles::BrokerFiles(std::string folder, const std::vector<std::string>& files,
                         const processes::ChildAccount* account)
    : folder_(std::move(folder)), account_(account) {
  if (mkdir(folder_.c_str(), S_IRWXU) != 0 && errno != EEXIST)
    throw config::Error(fmt::format("the folder {} cannot be made: {}", folder_, std::strerror(errno)));
  if (account_ != nullptr) account_->let_pass(folder_);
  std::set<std::string> used;
  for (const auto& file : files) {
    const std::string to = copy_of(folder_, file);
    if (!copies_.emplace(file, to).second) continue;
    used.insert(to);
    const auto stamp = config::stamp_of(file);
    try {
      copy(file, to);
      copied_[file] = stamp;
    } catch (const config::Error& error) {
      if (fs::exists(to)) {
        complain(file, stamp, error);
        continue;
      }
      throw config::Error(fmt::format(
          "driver hosts that are confined to files (host_files) get copies of what `brokers` names, and no copy of {} "
          "could be made: {}; this gateway's user must be able to read it",
          file, error.what()));
    }
  }
  for (const auto& entry : fs::directory_iterator(folder_)) {
    if (!used.contains(entry.path())) fs::remove_all(entry.path());
  }
}

InstanceSpec BrokerFiles::with_copies(InstanceSpec spec) const {
  for (auto& broker : spec.brokers) {
    brokers::change_files(broker.options, [this](std::string& file) {
      if (const auto found = copies_.find(file); found != copies_.end()) file = found->second;
    });
  }
  return spec;
}

void BrokerFiles::renew() {
  for (const auto& [file, to] : copies_) {
    const auto stamp = config::stamp_of(file);  // before the file is read: a change meanwhile is seen next time
    if (const auto last = copied_.find(file); last != copied_.end() && last->second == stamp) continue;
    try {
      const bool changed = copy(file, to);
      copied_[file] = stamp;
      if (complained_.erase(file) > 0 || changed) logger.info("driver hosts get {} as it is now", file);
    } catch (const config::Error& error) {
      complain(file, stamp, error);
    }
  }
}

bool BrokerFiles::copy(const std::string& file, const std::string& to) const {
  const std::string bytes = processes::read_file(file, most_bytes);
  if (has_bytes(to, bytes)) {
    if (account_ != nullptr) {
      account_->let_read(to);
      return false;
    }
    // An earlier run may have let another user read it.
    if (fs::status(to).permissions() == (fs::perms::owner_read | fs::perms::owner_write)) return false;
  }
  config::Replacement next(to, bytes, S_IRUSR | S_IWUSR);
  if (account_ != nullptr) account_->let_read(next.path());
  next.replace();
  return true;
}

void BrokerFiles::complain(const std::string& file, const config::FileStamp& stamp, const config::Error& error) {
  const auto said = complained_.find(file);
  if (said != complained_.end() && said->second == stamp) return;
  complained_[file] = stamp;
  logger.warn("driver hosts go on with {} as it was, because it cannot be copied: {}", file, error.what());
}

}  // namespace iotcloud::gateway
