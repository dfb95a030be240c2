#pragma once

#include <cstddef>
#include <string>

namespace iotcloud::master {

/// The last lines of an audit log, the newest last: {"lines": [...], "more": whether there are older ones}. Looks at
/// the last 8 MiB. \param text only lines that contain it; empty: all. \param most lines at most \throws config::Error
/// when the file cannot be read
std::string last_audit_lines(const std::string& file, const std::string& text, std::size_t most);

}  // namespace iotcloud::master
