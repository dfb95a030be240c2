#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include <boost/asio/io_context.hpp>

#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/robot/session.h>

namespace iotcloud::drivers::turtle::robot {

struct AgentOptions {
  std::string driver;  ///< "HOST:PORT" of the turtle driver
  std::string token;   ///< the driver's
  std::string name;    ///< for the driver's log
  std::chrono::milliseconds silence{250};
  std::chrono::milliseconds reconnect{100};  ///< before the first new attempt; doubles, each drawn from its upper half
  std::chrono::milliseconds longest_wait{5'000};  ///< before a new attempt
  int in_flight = 2;                              ///< frames under way that the driver has not acknowledged
};

/// The robot's laptop: takes frames from a source, compresses and sends the newest to the turtle driver, and gives what
/// comes back to the actuator. When no command came for the watchdog's time, or the connection ends, the robot is
/// stopped. Everything runs on the thread that runs the loop.
class Agent {
 public:
  struct Counts {
    std::uint64_t frames = 0;      ///< that the source had while it was wanted
    std::uint64_t sent = 0;        ///< among them, and those sent again
    std::uint64_t superseded = 0;  ///< by a newer one before they could be sent
    std::uint64_t unwanted = 0;    ///< that came while nobody was connected
    std::uint64_t attempts = 0;    ///< to connect
    std::uint64_t connects = 0;
    std::uint64_t lost = 0;  ///< connections that ended by themselves
    std::uint64_t commands = 0;
    std::uint64_t watchdog_stops = 0;
    std::uint64_t link_stops = 0;  ///< stops because a connection ended
  };

  /// `loop`, `context` and what `turtle` refers to outlive this. \throws std::exception as the device's maker does.
  Agent(boost::asio::io_context& loop, AgentOptions options, const TurtleOptions& turtle, DriverContext& context);
  ~Agent();
  Agent(const Agent&) = delete;
  Agent& operator=(const Agent&) = delete;

  /// Connects, and again whenever a connection ended.
  void start();
  /// Ends the connection, stops robot and source.
  void stop();
  const Counts& counts() const { return counts_; }

 private:
  void connect();
  void receive(const Incoming& message);
  void lose(const std::string& reason);
  void take(const DepthFrame& frame);
  void send_newest();
  void drive(const Velocity& velocity);
  void arm_watchdog();
  void pause_source();

  boost::asio::io_context& loop_;
  const AgentOptions options_;
  const TurtleOptions turtle_;
  DriverContext& context_;
  Device device_;
  depth::DepthEncoder encoder_;
  Counts counts_;
  std::minstd_rand random_{std::random_device{}()};
  bool running_ = false, source_runs_ = false;
  bool told_lost_ = false;  ///< that there is no connection was logged
  std::chrono::milliseconds wait_;
  std::optional<HandlerId> retry_, watchdog_;

  std::unique_ptr<Session> session_;  ///< nullptr between two attempts
  bool wanted_ = false;               ///< the driver wants frames
  int under_way_ = 0;
  /// The newest frame, until it is sent.
  struct Waiting {
    std::vector<std::uint16_t> disparities = std::vector<std::uint16_t>(depth::frame_pixels);
    FrameHead head;
    std::chrono::steady_clock::time_point captured;
    bool full = false;
  } waiting_;
  std::uint64_t number_ = 0;  ///< of the newest frame
};

}  // namespace iotcloud::drivers::turtle::robot
