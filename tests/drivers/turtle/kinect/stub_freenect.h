#pragma once

#include <cstdint>
#include <string>
#include <vector>

/// In place of libfreenect in the test's own program: its functions, and Kinects that a test plugs in and pulls out.
namespace iotcloud::drivers::turtle::kinect::stub {

struct Kinect {
  std::string serial;
  bool opens = true;
  bool has_motor = true;
  bool sends = true;  ///< a frame in each call that polls
};

/// What is on the USB from now on; those that were open are gone when they are not in it. Thread safe, as all here.
void plug_in(std::vector<Kinect> kinects);
/// After hold(true) no frame comes, also none that was under way, until hold(false).
void hold(bool on);

struct Seen {
  int contexts = 0;  ///< open now
  int devices = 0;   ///< open now
  std::string opened;
  double tilt = 0;
  int led = -1;
  bool motor_selected = false;
  std::uint64_t frames = 0;  ///< sent in all; the values of frame n are all n, its stamp n times 2 s
};
Seen seen();
void reset();

}  // namespace iotcloud::drivers::turtle::kinect::stub
