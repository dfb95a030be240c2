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

/// Gives a folder to the account, but only if it belongs to root: otherwise another user could replace entries by links
/// while this runs.
void give_folder(const std::string& folder, const Account& account) {
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

constexpr uid_t as_before = static_cast<uid_t>(-1);
constexpr mode_t group_too = S_IRWXU | S_IRWXG;

/// Lets the account's group use a folder as its owner does. The folder is opened to it last: until then nobody else can
/// replace entries by links.
void share_folder(const std::string& folder, const Account& account) {
  if (mkdir(folder.c_str(), S_IRWXU) != 0 && errno != EEXIST) throw failed(folder, "be made");
  struct stat status {};
  if (lstat(folder.c_str(), &status) != 0 || !S_ISDIR(status.st_mode) || status.st_uid != geteuid()) {
    throw config::Error(fmt::format("{} is no folder of this user", folder));
  }
  if (status.st_gid == account.group && (status.st_mode & group_too) == group_too) return;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    const mode_t rights = entry.is_directory() ? group_too : S_IRUSR | S_IWUSR | S_IRGRP | S_IWGRP;
    if (lchown(entry.path().c_str(), as_before, account.group) != 0 || chmod(entry.path().c_str(), rights) != 0) {
      throw failed(entry.path(), "be shared");
    }
  }
  if (lchown(folder.c_str(), as_before, account.group) != 0 || chmod(folder.c_str(), group_too) != 0) {
    throw failed(folder, "be shared");
  }
}

}  // namespace

ChildAccount::ChildAccount(const std::string& user, const std::string& state_folder)
    : gives_(geteuid() == 0), account_(checked(user)) {
  // Whoever can connect to a process can give it orders, but the sockets there belong to this process's user.
  let_pass(state_folder);
}

void ChildAccount::let_pass(const std::string& folder) const {
  if (chown(folder.c_str(), gives_ ? 0 : as_before, account_.group) != 0 ||
      chmod(folder.c_str(), S_IRWXU | S_IXGRP) != 0) {
    throw failed(folder, fmt::format("be made passable for the user {} (this daemon's user must be a member of its "
                                     "group)",
                                     account_.name));
  }
}

void ChildAccount::let_use(const std::string& folder) const {
  if (gives_) {
    give_folder(folder, account_);
  } else {
    share_folder(folder, account_);
  }
}

void ChildAccount::let_read(const std::string& file) const {
  struct stat status {};
  constexpr mode_t rights = owner_only | S_IRGRP;
  if (stat(file.c_str(), &status) == 0 && status.st_gid == account_.group && (status.st_mode & ALLPERMS) == rights)
    return;
  if (chown(file.c_str(), as_before, account_.group) != 0 || chmod(file.c_str(), rights) != 0)
    throw failed(file, fmt::format("be made readable for the user {}", account_.name));
}

void ChildAccount::make_file(const std::string& file) const {
  const OwnedDescriptor made(open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_NOFOLLOW | O_CLOEXEC, owner_only));
  const bool given = made && (gives_ ? fchown(made.get(), account_.user, account_.group) == 0
                                     : fchown(made.get(), as_before, account_.group) == 0 &&
                                           fchmod(made.get(), owner_only | S_IWGRP) == 0);
  if (!given) {
    throw failed(file, fmt::format("be made for the user {}", account_.name));
  }
}

void ChildAccount::keep_within_bounds(const LogFile::Options& options) const {
  const OwnedDescriptor written(open(options.path.c_str(), O_WRONLY | O_NOFOLLOW | O_CLOEXEC));
  if (!written || !move_log(options, written.get())) return;
  try {
    make_file(options.path);  // processes that write to the old log notice the new one and switch to it
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
