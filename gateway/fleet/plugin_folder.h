#pragma once

#include <string>

namespace iotcloud::gateway {

/// Checks the permissions of the plugin folder: whoever may write to it decides which code runs here.
/// \throws config::Error that says how to mend it, if every user may write to the folder. A missing folder passes.
void check_plugin_folder(const std::string& folder);
/// Checks the same of one plugin's file and of its folder.
void check_plugin_file(const std::string& folder, const std::string& file_name);

}  // namespace iotcloud::gateway
