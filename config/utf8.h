#pragma once

#include <string_view>

namespace iotcloud::config {

/// Whether the bytes are UTF-8 of code points that Unicode has: overlong forms and surrogates are none. Thread safe.
bool is_utf8(std::string_view text);

}  // namespace iotcloud::config
