#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/processes/logger.h>
#include <iotcloud/processes/random_name.h>
#include <iotcloud/processes/state_folder.h>

namespace iotcloud::processes {

namespace {

/// If a file or folder gives rights beyond `allowed`, leaves its owner's alone. \return whether it did
bool close_to_others(const std::string& path, mode_t allowed) {
  constexpr mode_t all = S_IRWXU | S_IRWXG | S_IRWXO;
  struct stat status {};
  if (lstat(path.c_str(), &status) != 0 || (status.st_mode & all & ~allowed) == 0) return false;
  if (chmod(path.c_str(), status.st_mode & allowed & S_IRWXU) != 0) {
    logger.warn("{} is open to others, and cannot be closed: {}; make it this user's own: chmod go-rwx {}", path,
                std::strerror(errno), path);
    return false;
  }
  return true;
}

/// Whoever may write in a state folder can make the daemon run its own code as the daemon's user, and its files name
/// people's devices.
void close_folder(const std::string& folder) {
  // A host under an account of its own passes through the folder by its group (ChildAccount).
  if (close_to_others(folder, S_IRWXU | S_IXGRP)) {
    logger.warn("the state folder {} was open to others; now it is not", folder);
  }
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    const bool file = entry.symlink_status(error).type() == std::filesystem::file_type::regular;
    if (!file || !close_to_others(entry.path(), S_IRUSR | S_IWUSR)) continue;
    logger.warn("{} was open to others; now it is not", entry.path().string());
  }
}

}  // namespace

StateFolder::StateFolder(const std::string& path) : path_(std::filesystem::absolute(path).lexically_normal()) {
  std::error_code error;
  const bool made = std::filesystem::create_directories(path_, error);
  if (error) throw config::Error(fmt::format("the state folder {} cannot be made: {}", path_, error.message()));
  if (made) chmod(path_.c_str(), S_IRWXU);  // whoever can connect to a host can run its drivers
  lock_ = OwnedDescriptor(open((path_ + "/lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, S_IRUSR | S_IWUSR));
  if (!lock_) throw config::Error(fmt::format("{}/lock cannot be opened: {}", path_, std::strerror(errno)));
  if (flock(lock_.get(), LOCK_EX | LOCK_NB) != 0) {
    throw config::Error(
        fmt::format("the state folder {} is in use by another process; give each one of its own", path_));
  }
  if (!made) close_folder(path_);
  const std::string id_file = path_ + "/id";
  std::ifstream(id_file) >> id_;
  if (!id_.empty()) return;
  id_ = random_name();
  config::replace_file(id_file, id_ + "\n", S_IRUSR | S_IWUSR);
}

}  // namespace iotcloud::processes
