#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/gateway/processes/state_folder.h>

namespace iotcloud::gateway {

StateFolder::StateFolder(const std::string& path) : path_(std::filesystem::absolute(path).lexically_normal()) {
  std::error_code error;
  const bool made = std::filesystem::create_directories(path_, error);
  if (error) throw config::Error(fmt::format("the state folder {} cannot be made: {}", path_, error.message()));
  if (made) chmod(path_.c_str(), S_IRWXU);  // who may talk to a host may run its drivers
  lock_ = OwnedDescriptor(open((path_ + "/lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, S_IRUSR | S_IWUSR));
  if (!lock_) throw config::Error(fmt::format("{}/lock cannot be opened: {}", path_, std::strerror(errno)));
  if (flock(lock_.get(), LOCK_EX | LOCK_NB) != 0) {
    throw config::Error(
        fmt::format("the state folder {} is in use by another gateway; give each gateway one of its own", path_));
  }
  const std::string id_file = path_ + "/id";
  std::ifstream(id_file) >> id_;
  if (!id_.empty()) return;
  id_ = discovery::new_instance_id();
  if (!(std::ofstream(id_file) << id_ << '\n').flush()) {
    throw config::Error(fmt::format("{} cannot be written: {}", id_file, std::strerror(errno)));
  }
}

}  // namespace iotcloud::gateway
