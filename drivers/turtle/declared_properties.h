#pragma once

#include <array>
#include <cstddef>

#include <iotcloud/drivers/declaration.h>

namespace iotcloud::drivers::turtle {

/// The properties of turtle.so. Those of a kind of device have no declared default: the driver refuses properties of
/// kinds that are not in use, and a declared default is given to every instance.
inline constexpr std::array shipped_properties{
    PropertySpec{.name = "source",
                 .default_value = "simulator",
                 .choices = {"simulator", "kinect", "recording", "robot"},
                 .text = "where frames come from"},
    PropertySpec{.name = "actuator",
                 .choices = {"simulator", "robot", "none"},
                 .text = "where commands go; the source's own if it has one, else none"},
    PropertySpec{.name = "broker", .text = "logical broker of both channels; the gateway's first"},
    PropertySpec{.name = "rate",
                 .type = PropertyType::number,
                 .unit = "1/s",
                 .min = 1,
                 .max = 120,
                 .default_value = "30",
                 .text = "frames a second; a real device sends at most this many"},
    PropertySpec{.name = "frames",
                 .type = PropertyType::integer,
                 .min = 0,
                 .default_value = "0",
                 .text = "stop producing after this many; 0: never"},
    PropertySpec{.name = "codec",
                 .default_value = "reference",
                 .choices = {"reference", "compact", "lossless"},
                 .text = "of the channel kinect"},
    PropertySpec{.name = "watchdog_ms",
                 .type = PropertyType::integer,
                 .unit = "ms",
                 .min = 20,
                 .max = 10'000,
                 .default_value = "250",
                 .text = "stop the robot when no command has come for this long"},
    PropertySpec{.name = "trace", .text = "CSV file with a row for each frame; none"},
    PropertySpec{
        .name = "seed", .type = PropertyType::integer, .min = 0, .text = "simulator: of the world's random numbers; 1"},
    PropertySpec{.name = "clock",
                 .choices = {"realtime", "lockstep"},
                 .text = "simulator: real time, or a frame for each command; realtime"},
    PropertySpec{.name = "retry_ms",
                 .type = PropertyType::integer,
                 .unit = "ms",
                 .min = 10,
                 .max = 60'000,
                 .text = "simulator: in lock step, send a frame again after this long; 500"},
    PropertySpec{.name = "person",
                 .choices = {"waits", "walks"},
                 .text = "simulator: the person walks from the first command on, or from the start; waits"},
    PropertySpec{.name = "device", .text = "kinect: index or serial number; 0"},
    PropertySpec{.name = "tilt",
                 .type = PropertyType::number,
                 .unit = "degrees",
                 .min = -30,
                 .max = 30,
                 .text = "kinect: the camera's angle above the horizon; left alone"},
    PropertySpec{.name = "led",
                 .choices = {"off", "green", "red", "yellow", "blink_green", "blink_red_yellow"},
                 .text = "kinect: the light; left alone"},
    PropertySpec{.name = "reconnect_ms",
                 .type = PropertyType::integer,
                 .unit = "ms",
                 .min = 1,
                 .max = 60'000,
                 .text = "kinect: wait before a missing device is looked for again; 500"},
    PropertySpec{.name = "silence_ms",
                 .type = PropertyType::integer,
                 .unit = "ms",
                 .min = 20,
                 .max = 60'000,
                 .text = "kinect (5000, at least 200), robot (watchdog_ms): without frames for this long it is away"},
    PropertySpec{.name = "path", .text = "recording: its folder; needed"},
    PropertySpec{.name = "loop", .type = PropertyType::flag, .text = "recording: begin again at the end; true"},
    PropertySpec{.name = "speed",
                 .type = PropertyType::number,
                 .min = 0.01,
                 .max = 100,
                 .text = "recording: 2 plays twice as fast; 1"},
    PropertySpec{.name = "listen", .text = "robot: address:port where its agent connects; 127.0.0.1:7411"},
    PropertySpec{.name = "token", .text = "robot: the secret of both ends; none"},
};

/// The properties with one kind of device more.
/// \param kind its name, as source and as actuator. \param own the properties of the kind
template <std::size_t Count>
consteval auto with_kind(std::string_view kind, const std::array<PropertySpec, Count>& own) {
  std::array<PropertySpec, shipped_properties.size() + Count> all{};
  std::size_t next = 0;
  for (PropertySpec spec : shipped_properties) {
    if (spec.name == "source" || spec.name == "actuator") spec.choices.add(kind);
    all[next++] = spec;
  }
  for (const PropertySpec& spec : own) all[next++] = spec;
  return all;
}

}  // namespace iotcloud::drivers::turtle
