#pragma once

#include <memory>
#include <string>

#include <iotcloud/config/error.h>
#include <iotcloud/drivers/plugin.h>

namespace iotcloud::gateway {

/// A driver's code, checked: the descriptor of a shared library, or one that is linked in. Never unloaded: dlclose
/// cannot promise that code really leaves; the end of its host process does.
class Plugin {
 public:
  /// Opens a shared library and checks its descriptor before any C++ call into it.
  /// \throws config::Error: no such file, no descriptor, or built for another SDK (names both sides).
  static std::shared_ptr<const Plugin> load(const std::string& path);
  /// The same of a file whose bytes were checked before: what is opened is a copy of them that nobody can change.
  /// \param sha256 of the bytes that were checked. \param name of the plugin, for messages.
  /// \throws config::Error as above, and when the file has other bytes by now.
  static std::shared_ptr<const Plugin> load_exactly(const std::string& path, const std::string& sha256,
                                                    const std::string& name);
  /// A linked-in driver. `descriptor` outlives the plugin. \throws config::Error as above.
  static std::shared_ptr<const Plugin> wrap(const drivers::Descriptor& descriptor, const std::string& origin);

  const drivers::Descriptor& descriptor() const { return *descriptor_; }
  std::string name() const { return descriptor_->name; }
  const std::string& origin() const { return origin_; }  ///< path, for messages

 private:
  static std::shared_ptr<const Plugin> open(const std::string& path, const std::string& origin);
  Plugin(const drivers::Descriptor* descriptor, std::string origin)
      : descriptor_(descriptor), origin_(std::move(origin)) {}
  const drivers::Descriptor* descriptor_;
  std::string origin_;
};

/// A plugin is named by a plain file name inside the gateway's plugin folder, wherever the name came from.
/// \throws config::Error for an empty name, one with a slash, "." or "..", or a control character.
void check_plugin_file_name(const std::string& file_name);

/// Names of drivers, gateways, instances and channels become parts of registry paths and wire names.
/// \param what the thing that is named, for the message ("driver name"). \throws config::Error.
void check_name(const std::string& what, const std::string& name);

}  // namespace iotcloud::gateway
