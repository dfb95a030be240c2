#include <fmt/format.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/fleet/plugin_folder.h>

namespace iotcloud::gateway {

namespace {

void check_writers(const std::string& path, const char* what) {
  struct stat status {};
  if (stat(path.c_str(), &status) != 0 || (status.st_mode & S_IWOTH) == 0) return;
  throw config::Error(fmt::format(
      "the {} {} can be written by everybody, who could so run what they like here: chmod o-w {}", what, path, path));
}

}  // namespace

void check_plugin_folder(const std::string& folder) {
  check_writers(folder, "plugin folder");
}

void check_plugin_file(const std::string& folder, const std::string& file_name) {
  check_plugin_folder(folder);
  check_writers(folder + "/" + file_name, "plugin");
}

}  // namespace iotcloud::gateway
