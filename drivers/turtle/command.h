#pragma once

#include <optional>
#include <string_view>

#include <iotcloud/drivers/turtle/device.h>

namespace iotcloud::drivers::turtle {

/// Reads a command (docs/wire.md#follower): {"linear":{"x":..,"y":..,"z":..},"angular":{"x":..,"y":..,"z":..}}, of
/// which linear.x and angular.z must be there and be finite numbers. Trusts nothing. \return nothing for what is no
/// command.
std::optional<Velocity> parse_command(std::string_view text) noexcept;

}  // namespace iotcloud::drivers::turtle
