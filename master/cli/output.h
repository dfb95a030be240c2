#pragma once

#include <cstdint>
#include <iosfwd>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <iotcloud/master/cli/command.h>

namespace iotcloud::master::cli {

/// Columns as wide as their widest cell; the last one is not padded. Widths count UTF-8 characters.
void print_table(std::ostream& out, const std::vector<std::string>& head,
                 const std::vector<std::vector<std::string>>& rows);

/// Block style; strings that YAML could read as something else are quoted.
void print_yaml(std::ostream& out, const nlohmann::ordered_json& value);

/// As `format` says; not for tables.
void print_data(std::ostream& out, Format format, const nlohmann::ordered_json& json);

/// "12s", "5m", "3h", "2d" since `since_ms` (wall time); "-" when it is not known.
std::string age(std::int64_t since_ms, std::int64_t now_ms);

/// For people's eyes: control characters of what others wrote cannot steer the terminal.
std::string printable(const std::string& text);

/// A broker's URL with *** for the password in it.
std::string without_password(const std::string& url);

}  // namespace iotcloud::master::cli
