#pragma once

#include <string>

namespace iotcloud::master {

/// The id of the instance that a deployment's name and a number say, on one gateway: always the same (a UUID of version
/// 5 without dashes), so that an instance that is deployed again has its channels' names and its spool again.
std::string named_instance_id(const std::string& gateway, const std::string& name, int index);

}  // namespace iotcloud::master
