#pragma once

#include <string>

namespace iotcloud::master::cli {

/// Whether a plugin is named as a file of this machine, which is to be sent: it has a slash ("./turtle.so"). Without
/// one it is the name of a file in the gateways' plugin folders, whatever files there are here.
bool is_local_plugin(const std::string& plugin);

/// All of a plugin. \throws std::invalid_argument for one that cannot be sent: a folder, nothing, unreadable.
std::string plugin_bytes(const std::string& path);

/// The signature in PATH.sig beside it; empty: there is none. \throws std::invalid_argument for one of another size.
std::string plugin_signature(const std::string& path);

}  // namespace iotcloud::master::cli
