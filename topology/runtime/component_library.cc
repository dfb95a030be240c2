#include <cstring>
#include <exception>

#include <dlfcn.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/shared_library.h>
#include <iotcloud/topology/runtime/component_library.h>

namespace iotcloud::topology {

ComponentLibrary::ComponentLibrary(std::string path) : path_(std::move(path)) {
  constexpr config::SdkMark mark{"topology SDK", IOTCLOUD_TOPOLOGY_SDK_MARK, sdk_version};
  void* const handle =
      config::open_library(path_, "the component library " + path_, mark, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  using Describe = const LibraryDescriptor* (*)();
  const auto describe = reinterpret_cast<Describe>(dlsym(handle, library_symbol));
  if (describe == nullptr) {
    throw config::Error(path_ + " is no component library: it has no symbol " + library_symbol +
                        "; put IOTCLOUD_TOPOLOGY_LIBRARY(registry) { ... } into one of its source files");
  }
  descriptor_ = describe();
  if (descriptor_->sdk_version != sdk_version || descriptor_->size != sizeof(LibraryDescriptor)) {
    throw config::Error(path_ + " was built with topology SDK " + std::to_string(descriptor_->sdk_version) +
                        ", this program has " + std::to_string(sdk_version) + "; build the library again");
  }
  if (std::strcmp(descriptor_->cxx_abi, cxx_abi) != 0) {
    throw config::Error(path_ + " was built for C++ ABI \"" + descriptor_->cxx_abi + "\", this program for \"" +
                        cxx_abi + "\"; build it with the same compiler and standard library");
  }
  config::share_log(handle);
}

void ComponentLibrary::fill(ComponentRegistry& registry) const {
  try {
    descriptor_->fill(registry);
  } catch (const std::exception& e) {
    throw config::Error(path_ + " failed to register its components: " + e.what());
  } catch (...) {
    throw config::Error(path_ + " failed to register its components: it threw something that is no std::exception");
  }
}

ComponentLibrary load_components(const std::string& path, ComponentRegistry& registry) {
  ComponentLibrary library(path);
  library.fill(registry);
  return library;
}

}  // namespace iotcloud::topology
