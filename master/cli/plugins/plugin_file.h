#pragma once

#include <string>

namespace iotcloud::master::cli {

/// Whether the plugin is a file of this machine, which must be sent: its name contains a slash ("./turtle.so"). A name
/// without a slash is a file in the gateways' plugin folders, even if this folder has a file of that name.
bool is_local_plugin(const std::string& plugin);

/// Reads the plugin file. \throws std::invalid_argument when it cannot be sent: it is a folder, empty or unreadable.
std::string plugin_bytes(const std::string& path);

/// Reads the signature in PATH.sig; empty: there is none. \throws std::invalid_argument when its size is wrong.
std::string plugin_signature(const std::string& path);

}  // namespace iotcloud::master::cli
