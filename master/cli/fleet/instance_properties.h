#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

/// Properties that differ from one instance of a deployment to the next.
namespace iotcloud::master::cli {

using Texts = std::map<std::string, std::string>;

/// Reads CSV: a head of names, then a line for each instance; a value with a comma or a quote stands in double quotes.
/// An empty value leaves the property out. \param file for messages.
/// \throws config::ConfigError with file and line
std::vector<Texts> read_csv(std::string_view text, const std::string& file);

}  // namespace iotcloud::master::cli
