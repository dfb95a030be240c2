#pragma once

#include <string>
#include <string_view>

#include <iotcloud/processes/descriptor.h>

/// Steps for files that are complete or not there, even after a crash. All functions throw config::Error with path and
/// reason.
namespace iotcloud::processes {

/// Creates a file that only its owner may use; fails if it exists.
OwnedDescriptor create_file(const std::string& path);
void write_all(const OwnedDescriptor& file, std::string_view bytes, const std::string& path);
/// Waits until the file's bytes are on the disk; its name is when config::sync_folder() has returned.
void sync_file(const OwnedDescriptor& file, const std::string& path);

/// Reads a whole file. \param most fails if the file has more bytes; 0: no limit.
std::string read_file(const std::string& path, std::size_t most);

}  // namespace iotcloud::processes
