#pragma once

#include <chrono>
#include <cstdint>
#include <iosfwd>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

/// What programs of the command line print, for people and for programs.
namespace iotcloud::config::output {

/// A table for people, or one document for programs.
enum class Format { table, json, yaml };

/// Prints a table. Each column is as wide as its widest cell; the last one is not padded. Widths count UTF-8
/// characters.
void print_table(std::ostream& out, const std::vector<std::string>& head,
                 const std::vector<std::vector<std::string>>& rows);

/// Writes `value` as one YAML document in block style. A reader gets the same value: strings that YAML could read as
/// something else are quoted; bytes that are not UTF-8 become U+FFFD .
void print_yaml(std::ostream& out, const nlohmann::ordered_json& value);

/// Prints the table or the data, as `format` says.
void print(std::ostream& out, Format format, const std::vector<std::string>& head,
           const std::vector<std::vector<std::string>>& rows, const nlohmann::ordered_json& json);

/// Prints data as JSON or YAML, as `format` says; must not be called for tables.
void print_data(std::ostream& out, Format format, const nlohmann::ordered_json& json);

/// "12s", "5m", "3h", "2d" since `since_ms` (wall time); "-" when it is not known.
std::string age(std::int64_t since_ms, std::int64_t now_ms);
/// Wall time for people, in UTC.
std::string moment(std::int64_t time_ms);
/// Milliseconds since 1970, by the system's clock.
std::int64_t now_ms();

/// When something began that has lasted so long, in milliseconds since 1970.
std::int64_t began_ms(std::chrono::seconds lasted);

/// The text without control characters, so that text from elsewhere cannot control the terminal.
std::string printable(const std::string& text);

}  // namespace iotcloud::config::output
