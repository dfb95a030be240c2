#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <yaml-cpp/node/node.h>

#include <iotcloud/config/error.h>

namespace iotcloud::config::internal {

/// Nobody mends more errors of a file at once; looking for more would take long in a file of nothing else.
constexpr std::size_t most_errors = 100;

/// The place of a yaml-cpp mark in a file.
Location location(const std::string& file, const YAML::Mark& mark);

/// Reads the only document of a text that passed checked_text(); a null node if it is empty. Every returned tree can be
/// walked in a short time, aliases included.
/// \param name stands for the file in messages.
/// \throws ConfigError for a text that is not YAML, a second document, collections nested more than 32 deep, an alias
/// that contains itself, and more than 500'000 values (an alias counts each time as all that it stands for).
/// \param duplicates gets an error for each key that a mapping has twice, the first `most_errors` of them.
YAML::Node read_document(const std::string& text, const std::string& name, std::vector<ConfigError>& duplicates);

}  // namespace iotcloud::config::internal
