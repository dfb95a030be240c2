#pragma once

#include <memory>
#include <string>

#include <iotcloud/config/declaration.h>
#include <iotcloud/config/error.h>
#include <iotcloud/drivers/plugin.h>

namespace iotcloud::gateway {

/// A driver's checked code: the descriptor of a shared library or of a linked-in driver. It is never unloaded, because
/// only the end of the host process, not dlclose(), is sure to remove code.
class Plugin {
 public:
  /// Opens a shared library and checks its descriptor before any C++ call into it.
  /// \throws config::Error: if the file or its descriptor is missing, or the plugin was built for another SDK (the
  /// message names both versions).
  static std::shared_ptr<const Plugin> load(const std::string& path);
  /// As load(), for a file whose bytes were checked before: loads a sealed copy that nobody can change.
  /// \param sha256 of the bytes that were checked. \param name of the plugin, for messages.
  /// \throws config::Error as above, and if the file has changed since.
  static std::shared_ptr<const Plugin> load_exactly(const std::string& path, const std::string& sha256,
                                                    const std::string& name);
  /// A linked-in driver. `descriptor` outlives the plugin. \throws config::Error as above.
  static std::shared_ptr<const Plugin> wrap(const drivers::Descriptor& descriptor, const std::string& origin);

  const drivers::Descriptor& descriptor() const { return *descriptor_; }
  std::string name() const { return descriptor_->name; }
  /// The properties that the driver declares.
  const config::DriverDeclaration& declaration() const { return declaration_; }
  const std::string& origin() const { return origin_; }  ///< path, for messages

 private:
  static std::shared_ptr<const Plugin> open(const std::string& path, const std::string& origin);
  Plugin(const drivers::Descriptor* descriptor, std::string origin)
      : descriptor_(descriptor),
        declaration_(config::declaration_of(descriptor->declaration)),
        origin_(std::move(origin)) {}
  const drivers::Descriptor* descriptor_;
  const config::DriverDeclaration declaration_;
  std::string origin_;
};

/// Checks that a plugin's name is a plain file name, so that it stays inside the gateway's plugin folder.
/// \throws config::Error for an empty name, one with a slash, "." or "..", or a control character.
void check_plugin_file_name(const std::string& file_name);

/// Checks the name of a driver, gateway, instance or channel, which becomes part of registry paths and wire names.
/// \param what names the thing in the message ("driver name"). \throws config::Error for an unusable name.
void check_name(const std::string& what, const std::string& name);

}  // namespace iotcloud::gateway
