#pragma once

#include <string>
#include <string_view>

#include <iotcloud/gateway/host/control/unix_socket.h>

/// Files that are whole or not there, whatever happens meanwhile. All \throw config::Error with path and reason.
namespace iotcloud::gateway {

/// A new file for its owner only. Never one that is there already.
OwnedDescriptor create_file(const std::string& path);
void write_all(const OwnedDescriptor& file, std::string_view bytes, const std::string& path);
/// Returns when the bytes, or a folder's names, are on the disk.
void sync_file(const OwnedDescriptor& file, const std::string& path);
void sync_folder(const std::string& path);

/// All bytes. \param most \throws also when there are more. 0: any number.
std::string read_file(const std::string& path, std::size_t most);

}  // namespace iotcloud::gateway
