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
#include <iotcloud/processes/child_account.h>
#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/logger.h>

namespace iotcloud::processes {

namespace fs = std::filesystem;

namespace {

constexpr mode_t owner_only = S_IRUSR | S_IWUSR;

config::Error failed(const std::string& path, const std::string& what) {
  return config::Error(fmt::format("{} cannot {}: {}", path, what, std::strerror(errno)));
}

Account checked(const std::string& user) {
  Account account = find_account(user);
  if (account.user == 0) throw config::Error(fmt::format("processes as the user {} would be root all the same", user));
  return account;
}

/// Gives the spools to the account, but only if the folder belongs to root: otherwise another user could replace
/// entries by links while this runs.
void give_spools(const std::string& folder, const Account& account) {
  if (mkdir(folder.c_str(), S_IRWXU) != 0 && errno != EEXIST) throw failed(folder, "be made");
  struct stat status {};
  if (lstat(folder.c_str(), &status) != 0 || !S_ISDIR(status.st_mode)) {
    throw config::Error(fmt::format("{} is no folder", folder));
  }
  if (status.st_uid == account.user) return;
  if (status.st_uid != 0) {
    throw config::Error(fmt::format(
        "{} belongs to another user than {}, as which processes are to run here; when none runs as that one any "
        "more: chown -R {} {}",
        folder, account.name, account.name, folder));
  }
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (lchown(entry.path().c_str(), account.user, account.group) != 0) throw failed(entry.path(), "be given away");
  }
  if (lchown(folder.c_str(), account.user, account.group) != 0) throw failed(folder, "be given away");
}

}  // namespace

ChildAccount::ChildAccount(const std::string& user, const std::string& state_folder) : account_(checked(user)) {
  // Only the account's group may pass through the folder. Whoever can connect to a host can run its drivers, but the
  // hosts' sockets belong to root.
  if (chown(state_folder.c_str(), 0, account_.group) != 0 || chmod(state_folder.c_str(), S_IRWXU | S_IXGRP) != 0) {
    throw failed(state_folder, fmt::format("be made passable for the user {}", account_.name));
  }
  give_spools(state_folder + "/spool", account_);
}

void ChildAccount::make_log(const std::string& file) const {
  const OwnedDescriptor made(open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_NOFOLLOW | O_CLOEXEC, owner_only));
  if (!made || fchown(made.get(), account_.user, account_.group) != 0) {
    throw failed(file, fmt::format("be made for the user {}", account_.name));
  }
}

void ChildAccount::keep_within_bounds(const LogFile::Options& options) const {
  const OwnedDescriptor written(open(options.path.c_str(), O_WRONLY | O_NOFOLLOW | O_CLOEXEC));
  if (!written || !move_log(options, written.get())) return;
  try {
    make_log(options.path);  // hosts that write to the old log notice the new one and switch to it
  } catch (const config::Error& e) {
    logger.warn("{}", e.what());
  }
}

bool ChildAccount::runs(int process) const {
  std::ifstream status(fmt::format("/proc/{}/status", process));
  for (std::string line; std::getline(status, line);) {
    if (!line.starts_with("Uid:")) continue;
    uid_t real = 0;
    std::istringstream(line.substr(line.find(':') + 1)) >> real;
    return real == account_.user;
  }
  return true;
}

}  // namespace iotcloud::processes
