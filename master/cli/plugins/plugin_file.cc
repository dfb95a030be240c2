#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include <fmt/format.h>

#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/security/plugin_signature.h>

namespace iotcloud::master::cli {

namespace fs = std::filesystem;

bool is_local_plugin(const std::string& plugin) {
  return plugin.find('/') != std::string::npos;
}

std::string plugin_bytes(const std::string& path) {
  if (fs::is_directory(path)) throw std::invalid_argument(fmt::format("{} is a folder, not a plugin", path));
  std::ifstream in(path, std::ios::binary);
  std::string bytes(std::istreambuf_iterator<char>(in), {});
  if (!in) throw std::invalid_argument(fmt::format("the plugin {} cannot be read: {}", path, std::strerror(errno)));
  if (bytes.empty()) throw std::invalid_argument(fmt::format("the plugin {} is empty", path));
  return bytes;
}

std::string plugin_signature(const std::string& path) {
  const std::string file = path + ".sig";
  if (!fs::exists(file)) return "";
  std::ifstream in(file, std::ios::binary);
  std::string signature(std::istreambuf_iterator<char>(in), {});
  if (security::is_plugin_signature(signature)) return signature;
  throw std::invalid_argument(
      fmt::format("{} has {} bytes, an Ed25519 signature has {}; make it again with `iotcloud sign "
                  "{} --key KEY`, or remove it",
                  file, signature.size(), security::signature_bytes, path));
}

}  // namespace iotcloud::master::cli
