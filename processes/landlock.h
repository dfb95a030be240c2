#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace iotcloud::processes {

/// The files and folders that a confined process may reach, each with all that is below it.
struct FileAccess {
  std::vector<std::string> read;   ///< read, list and execute
  std::vector<std::string> write;  ///< also make, change, rename and remove; devices are opened and controlled
};

/// The version of the kernel's Landlock; 0: it has none.
int landlock_version();

/// From now on this process, all its threads and what they start reach only these files, and with version 6 of Landlock
/// send signals only to each other. Paths that do not exist are left out. Descriptors that are open stay usable. Needs
/// no_new_privileges. \return false if the kernel has no Landlock; then nothing changes. \throws config::Error
bool restrict_files(const FileAccess& allowed);

/// The first version of Landlock that knows of connections.
inline constexpr int landlock_of_connections = 4;

/// From now on this process, all its threads and what they start connect by TCP to these ports only, of any machine.
/// Other transports are not touched. Needs no_new_privileges. \throws config::Error, also if the kernel cannot do it.
void restrict_connections(const std::vector<std::uint16_t>& ports);

}  // namespace iotcloud::processes
