#pragma once

#include <string>

namespace iotcloud::processes {

/// 32 hexadecimal digits of the system's randomness: a unique name that nobody can guess. Thread safe.
std::string random_name();

}  // namespace iotcloud::processes
