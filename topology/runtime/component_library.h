#pragma once

#include <string>

#include <iotcloud/topology/plugin.h>

namespace iotcloud::topology {

/// A loaded component library. Its code stays loaded until the process ends, because code with threads, thread_local
/// destructors or unique symbols cannot be unloaded safely. So factories and objects that come from it never dangle.
class ComponentLibrary {
 public:
  /// Loads the shared library, and checks its descriptor before it makes any C++ call into it.
  /// \throws config::Error when the file cannot be loaded, is no component library, or was built with another SDK or
  /// compiler; the message says which of these, and what would be right.
  explicit ComponentLibrary(std::string path);

  /// Lets the library register its components and application.
  /// \throws config::Error when the library throws while it does so.
  void fill(ComponentRegistry& registry) const;

  const std::string& path() const { return path_; }

 private:
  std::string path_;
  const LibraryDescriptor* descriptor_;
};

/// Loads a component library and lets it register its components. \throws config::Error as the members do.
ComponentLibrary load_components(const std::string& path, ComponentRegistry& registry);

}  // namespace iotcloud::topology
