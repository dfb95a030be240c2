#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace iotcloud::config {

/// Each plugin of an SDK contains a text that says with which version of the SDK the plugin was built. This struct
/// describes the text, so that the version can also be read from a plugin that cannot be loaded.
struct SdkMark {
  std::string_view sdk;    ///< for messages: "driver SDK"
  std::string_view text;   ///< in the plugin's bytes this text stands before the version's number, and a ';' after it
  std::uint32_t expected;  ///< the version of the program that loads it
};

/// The version that stands in the file. \return 0: the file has no such mark, or cannot be read.
std::uint32_t marked_sdk_version(const std::string& path, const SdkMark& mark);

/// Loads a shared library with dlopen(). \param name of the library, for messages: `path` may be a copy that nobody
/// knows. \param flags of dlopen(). \throws Error that says which symbol or library is missing (C++ names as in the
/// source), and the SDK versions of both sides.
void* open_library(const std::string& path, const std::string& name, const SdkMark& mark, int flags);

/// The text of open_library()'s error. \param reason as dlerror() gives it.
std::string why_not_loaded(const std::string& path, const std::string& name, const SdkMark& mark,
                           std::string_view reason);

}  // namespace iotcloud::config
