#pragma once

#include <cstdint>
#include <string>
#include <vector>

/// Replaces libfreenect in the test's own program: its functions, and Kinects that a test plugs in and pulls out.
namespace iotcloud::drivers::turtle::kinect::stub {

struct Kinect {
  std::string serial;
  bool opens = true;
  bool has_motor = true;
  bool sends = true;  ///< sends a frame in each call that polls
};

/// Sets the Kinects on the USB; open ones that are missing in the list are gone. Thread safe, like all functions here.
void plug_in(std::vector<Kinect> kinects);
/// After hold(true) no frame comes until hold(false), not even one that was under way.
void hold(bool on);

struct Seen {
  int contexts = 0;  ///< open now
  int devices = 0;   ///< open now
  std::string opened;
  double tilt = 0;
  int led = -1;
  bool motor_selected = false;
  std::uint64_t frames = 0;  ///< sent so far; all values of frame n are n, its stamp is n times 2 s
};
Seen seen();
void reset();

}  // namespace iotcloud::drivers::turtle::kinect::stub
