#pragma once

#include <string>

#include <yaml-cpp/node/node.h>

#include <iotcloud/config/error.h>

namespace iotcloud::config::internal {

/// The place of a mark of yaml-cpp in a file.
Location location(const std::string& file, const YAML::Mark& mark);

/// The only document of a text that checked_text() has passed; a null node when it is empty. Every tree that it returns
/// can be walked in a short time, aliases included.
/// \param name stands for the file in messages.
/// \throws ConfigError for what is not YAML, a second document, collections nested more than 32 deep, an alias that
/// contains itself, more than 500'000 values (what an alias stands for counts each time), and a key that stands twice.
YAML::Node read_document(const std::string& text, const std::string& name);

}  // namespace iotcloud::config::internal
