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
  std::string token;   ///< the driver's token
  std::string name;    ///< appears in the driver's log
  std::chrono::milliseconds silence{250};
  std::chrono::milliseconds handshake{3'000};  ///< for connecting and the driver's proof
  /// Wait before the first new attempt; doubles with each. The agent waits a random time between half of it and all.
  std::chrono::milliseconds reconnect{100};
  std::chrono::milliseconds longest_wait{5'000};  ///< the longest wait before a new attempt
  /// How many frames may be under way without the driver's acknowledgement.
  int in_flight = 2;
};

/// The program on the robot's laptop. It takes frames from a source, encodes the newest and sends it to the turtle
/// driver, and gives the driver's commands to the actuator. It stops the robot when no command has come for the
/// watchdog's time, and when the connection ends. Everything runs on the thread that runs the loop.
class Agent {
 public:
  struct Counts {
    std::uint64_t frames = 0;      ///< frames from the source while it was wanted
    std::uint64_t sent = 0;        ///< those that were sent; counts a repeated frame each time
    std::uint64_t superseded = 0;  ///< frames that a newer one replaced before they could be sent
    std::uint64_t unwanted = 0;    ///< frames that came while no driver was connected
    std::uint64_t attempts = 0;    ///< attempts to connect
    std::uint64_t connects = 0;
    std::uint64_t lost = 0;  ///< connections that ended by themselves
    std::uint64_t commands = 0;
    std::uint64_t watchdog_stops = 0;
    std::uint64_t link_stops = 0;  ///< stops because a connection ended
  };

  /// `loop`, `context` and the objects that `turtle` refers to must outlive the agent. \throws std::exception from the
  /// device's maker.
  Agent(boost::asio::io_context& loop, AgentOptions options, const TurtleOptions& turtle, DriverContext& context);
  ~Agent();
  Agent(const Agent&) = delete;
  Agent& operator=(const Agent&) = delete;

  /// Connects, and connects again whenever a connection ends.
  void start();
  /// Ends the connection, and stops the robot and the source.
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
  bool told_lost_ = false;  ///< the lack of a connection was logged
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
  std::uint64_t number_ = 0;  ///< the newest frame's number
};

}  // namespace iotcloud::drivers::turtle::robot
