#pragma once

#include <string>

namespace iotcloud::gateway {

/// Whoever may write the plugin folder decides what runs here, so not everybody may.
/// \throws config::Error that says how to mend it, when everybody may write the folder. One that is not there is
/// nobody's.
void check_plugin_folder(const std::string& folder);
/// The same for one plugin and its folder.
void check_plugin_file(const std::string& folder, const std::string& file_name);

}  // namespace iotcloud::gateway
