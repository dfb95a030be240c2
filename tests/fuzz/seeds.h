#pragma once

#include <filesystem>
#include <string>

namespace iotcloud::fuzz {

/// One first input of one fuzzer.
void write(const std::filesystem::path& folder, const std::string& name, const std::string& bytes);

/// Calls of the Thrift services, as clients write them, one and several on a connection; manifests.
void write_control_plane_seeds(const std::filesystem::path& folder);

}  // namespace iotcloud::fuzz
