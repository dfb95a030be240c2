#pragma once

#include <map>
#include <string>

namespace iotcloud::master::cli {

/// The files of a new folder, by name. In their text and names @NAME@ stands for the project's name and @CLASS@ for a
/// class named so; in their text @SDK@ for the folder of the SDK's headers.
using Templates = std::map<std::string, std::string>;

/// \param kind "driver", "bolt", "topology" or "project"
Templates templates_of(const std::string& kind);

}  // namespace iotcloud::master::cli
