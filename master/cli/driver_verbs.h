#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include <iotcloud/discovery/records.h>

namespace iotcloud::master::cli {

/// A driver's record as JSON; metadata_words() has its metadata as text for tables.
nlohmann::ordered_json driver_json(const discovery::DriverRecord& driver);
std::string metadata_words(const discovery::DriverRecord& driver);
/// The instance's deployment name and number: "camera/2"; "-" when it was deployed without a name.
std::string full_name(const discovery::DriverRecord& driver);

}  // namespace iotcloud::master::cli
