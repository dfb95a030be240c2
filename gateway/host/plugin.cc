#include <algorithm>
#include <cerrno>
#include <cstring>
#include <vector>

#include <dlfcn.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <unistd.h>

#include <iotcloud/config/shared_library.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

namespace {

using drivers::Descriptor;

/// Checks the first three members of the descriptor before it reads any other.
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

/// Copies the file into sealed memory and checks the hash of the same bytes, so that the file cannot change between the
/// two.
/// \return the copy's descriptor.
int sealed_copy(const std::string& path, const std::string& sha256, const std::string& name) {
  const auto fail = [&](const char* what) {
    throw config::Error(
        fmt::format("the driver plugin {} ({}) cannot be {}: {}", name, path, what, std::strerror(errno)));
  };
  const processes::OwnedDescriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!file) fail("opened");
  constexpr std::size_t longest_name = 200;  // the kernel allows 249 bytes
  processes::OwnedDescriptor copy(memfd_create(name.substr(0, longest_name).c_str(), MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (!copy) fail("copied into memory");
  security::Sha256 sha;
  std::vector<char> buffer(std::size_t{256} * 1024);
  for (;;) {
    const auto got = read(file.get(), buffer.data(), buffer.size());
    if (got == 0) break;
    if (got < 0) fail("read");
    sha.add({buffer.data(), static_cast<std::size_t>(got)});
    for (ssize_t done = 0; done < got;) {
      const auto written = write(copy.get(), buffer.data() + done, static_cast<std::size_t>(got - done));
      if (written < 0) fail("copied into memory");
      done += written;
    }
  }
  if (fcntl(copy.get(), F_ADD_SEALS, F_SEAL_WRITE | F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0) fail("sealed");
  if (const auto found = sha.hex(); found != sha256)
    throw config::Error(
        fmt::format("the driver plugin {} ({}) was changed after the gateway had checked it: its SHA-256 is "
                    "{}, not {}",
                    name, path, security::short_sha256(found), security::short_sha256(sha256)));
  return copy.release();
}

}  // namespace

std::shared_ptr<const Plugin> Plugin::load(const std::string& path) {
  return open(path, path);
}

std::shared_ptr<const Plugin> Plugin::load_exactly(const std::string& path, const std::string& sha256,
                                                   const std::string& name) {
  // Never closed: the library is loaded under the path of this descriptor, whose number must not be reused for another
  // file.
  const int copy = sealed_copy(path, sha256, name);
  return open(fmt::format("/proc/self/fd/{}", copy), fmt::format("{} ({})", name, path));
}

std::shared_ptr<const Plugin> Plugin::open(const std::string& path, const std::string& origin) {
  // RTLD_LOCAL keeps classes with the same name in two plugins apart.
  constexpr config::SdkMark mark{"driver SDK", IOTCLOUD_DRIVER_SDK_MARK, drivers::sdk_version};
  void* const library = config::open_library(path, "the driver plugin " + origin, mark, RTLD_NOW | RTLD_LOCAL);
  auto* const symbol = dlsym(library, drivers::descriptor_symbol);
  if (symbol == nullptr) {
    dlclose(library);
    throw config::Error(fmt::format("{}: not a driver plugin, it exports no {}; use the macro IOTCLOUD_DRIVER", origin,
                                    drivers::descriptor_symbol));
  }
  const auto* descriptor = reinterpret_cast<const Descriptor* (*)()>(symbol)();
  if (descriptor == nullptr) throw config::Error(fmt::format("{}: its descriptor is null", origin));
  return wrap(*descriptor, origin);
}

std::shared_ptr<const Plugin> Plugin::wrap(const Descriptor& descriptor, const std::string& origin) {
  check(descriptor, origin);
  return std::shared_ptr<const Plugin>(new Plugin(&descriptor, origin));
}

void check_plugin_file_name(const std::string& file_name) {
  if (file_name.empty()) {
    throw config::Error("the order names no plugin; give its file name, for example \"turtle.so\"");
  }
  if (!processes::is_plain_file_name(file_name)) {
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
