#include <algorithm>
#include <cstring>

#include <dlfcn.h>
#include <fmt/format.h>

#include <iotcloud/gateway/host/plugin.h>

namespace iotcloud::gateway {

namespace {

using drivers::Descriptor;

/// Reads nothing but the first three members until they are known to be ours.
void check(const Descriptor& descriptor, const std::string& origin) {
  if (descriptor.sdk_version != drivers::sdk_version) {
    throw config::Error(fmt::format(
        "{}: built with driver SDK version {}, but this driver host has version {}; rebuild the driver with "
        "the host's SDK",
        origin, descriptor.sdk_version, drivers::sdk_version));
  }
  if (descriptor.size != sizeof(Descriptor)) {
    throw config::Error(fmt::format("{}: its descriptor has {} bytes, the driver host's has {}; rebuild the driver",
                                    origin, descriptor.size, sizeof(Descriptor)));
  }
  if (descriptor.cxx_abi == nullptr || std::strcmp(descriptor.cxx_abi, IOTCLOUD_CXX_ABI) != 0) {
    throw config::Error(fmt::format(
        "{}: built for the C++ ABI \"{}\", but this driver host has \"{}\"; build both with the same compiler and "
        "C++ library",
        origin, descriptor.cxx_abi == nullptr ? "" : descriptor.cxx_abi, IOTCLOUD_CXX_ABI));
  }
  if (descriptor.name == nullptr || descriptor.create == nullptr || descriptor.destroy == nullptr) {
    throw config::Error(fmt::format("{}: its descriptor lacks a name or its factories", origin));
  }
  check_name("driver name", descriptor.name);
}

bool has_control_characters(const std::string& text) {
  return std::any_of(text.begin(), text.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; });
}

}  // namespace

std::shared_ptr<const Plugin> Plugin::load(const std::string& path) {
  // RTLD_LOCAL: two plugins with a class of the same name do not see each other's.
  void* library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (library == nullptr) throw config::Error(fmt::format("the driver plugin cannot be loaded: {}", dlerror()));
  auto* const symbol = dlsym(library, drivers::descriptor_symbol);
  if (symbol == nullptr) {
    dlclose(library);
    throw config::Error(fmt::format("{}: not a driver plugin, it exports no {}; use the macro IOTCLOUD_DRIVER", path,
                                    drivers::descriptor_symbol));
  }
  const auto* descriptor = reinterpret_cast<const Descriptor* (*)()>(symbol)();
  if (descriptor == nullptr) throw config::Error(fmt::format("{}: its descriptor is null", path));
  return wrap(*descriptor, path);
}

std::shared_ptr<const Plugin> Plugin::wrap(const Descriptor& descriptor, const std::string& origin) {
  check(descriptor, origin);
  return std::shared_ptr<const Plugin>(new Plugin(&descriptor, origin));
}

void check_plugin_file_name(const std::string& file_name) {
  if (file_name.empty()) {
    throw config::Error("the order names no plugin; give its file name, for example \"turtle.so\"");
  }
  if (file_name == "." || file_name == ".." || file_name.find('/') != std::string::npos ||
      has_control_characters(file_name)) {
    throw config::Error(fmt::format(
        "\"{}\" is not a plain file name; a plugin is named by its file in the gateway's plugin folder (\"turtle.so\")",
        file_name));
  }
}

void check_name(const std::string& what, const std::string& name) {
  if (name.empty() || name == "." || name == ".." || name.find('/') != std::string::npos || name.size() > 200 ||
      has_control_characters(name)) {
    throw config::Error(
        fmt::format("\"{}\" cannot be used as {}: it must have 1 to 200 characters, no slash and no control character",
                    name, what));
  }
}

}  // namespace iotcloud::gateway
