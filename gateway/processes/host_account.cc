#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/gateway/host/control/unix_socket.h>
#include <iotcloud/gateway/processes/host_account.h>

namespace iotcloud::gateway {

namespace fs = std::filesystem;

namespace {

constexpr config::Logger log{"gateway"};
constexpr mode_t owner_only = S_IRUSR | S_IWUSR;

config::Error failed(const std::string& path, const std::string& what) {
  return config::Error(fmt::format("{} cannot {}: {}", path, what, std::strerror(errno)));
}

Account checked(const std::string& user) {
  Account account = find_account(user);
  if (account.user == 0)
    throw config::Error(fmt::format("driver hosts as the user {} would be root all the same", user));
  return account;
}

/// Only while all of it is root's own is nobody there who could put a link to something else in the way.
void give_spools(const std::string& folder, const Account& account) {
  if (mkdir(folder.c_str(), S_IRWXU) != 0 && errno != EEXIST) throw failed(folder, "be made");
  struct stat status {};
  if (lstat(folder.c_str(), &status) != 0 || !S_ISDIR(status.st_mode)) {
    throw config::Error(fmt::format("{} is no folder", folder));
  }
  if (status.st_uid == account.user) return;
  if (status.st_uid != 0) {
    throw config::Error(fmt::format(
        "{} belongs to another user than {}, as which driver hosts are to run; when none runs as that one any "
        "more: chown -R {} {}",
        folder, account.name, account.name, folder));
  }
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (lchown(entry.path().c_str(), account.user, account.group) != 0) throw failed(entry.path(), "be given away");
  }
  if (lchown(folder.c_str(), account.user, account.group) != 0) throw failed(folder, "be given away");
}

}  // namespace

HostAccount::HostAccount(const std::string& user, const std::string& state_folder) : account_(checked(user)) {
  // The account's group may pass, nobody else; who talks to a host may run its drivers, but its socket is root's.
  if (chown(state_folder.c_str(), 0, account_.group) != 0 || chmod(state_folder.c_str(), S_IRWXU | S_IXGRP) != 0) {
    throw failed(state_folder, fmt::format("be made passable for the user {}", account_.name));
  }
  give_spools(state_folder + "/spool", account_);
}

void HostAccount::make_log(const std::string& file) const {
  const OwnedDescriptor made(open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_NOFOLLOW | O_CLOEXEC, owner_only));
  if (!made || fchown(made.get(), account_.user, account_.group) != 0) {
    throw failed(file, fmt::format("be made for the user {}", account_.name));
  }
}

void HostAccount::keep_within_bounds(const LogFile::Options& options) const {
  const OwnedDescriptor written(open(options.path.c_str(), O_WRONLY | O_NOFOLLOW | O_CLOEXEC));
  if (!written || !move_log(options, written.get())) return;
  try {
    make_log(options.path);  // hosts that write to the old one see it and follow
  } catch (const config::Error& e) {
    log.warn("{}", e.what());
  }
}

bool HostAccount::runs(int process) const {
  std::ifstream status(fmt::format("/proc/{}/status", process));
  for (std::string line; std::getline(status, line);) {
    if (!line.starts_with("Uid:")) continue;
    uid_t real = 0;
    std::istringstream(line.substr(line.find(':') + 1)) >> real;
    return real == account_.user;
  }
  return true;
}

}  // namespace iotcloud::gateway
