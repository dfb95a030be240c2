#pragma once

#include <chrono>
#include <functional>
#include <list>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/drivers/turtle/device.h>
#include <iotcloud/drivers/turtle/device_kinds.h>
#include <iotcloud/drivers/turtle/robot/connection.h>
#include <iotcloud/drivers/turtle/robot/protocol.h>

namespace iotcloud::drivers::turtle::robot {

struct LinkOptions {
  std::string listen = "127.0.0.1:7411";
  std::string token;
  std::chrono::milliseconds silence{250};
};

/// The kind `robot`; README.md lists its properties.
DeviceKind robot_kind();

/// The driver's end of a robot whose laptop reads, encodes and sends the frames (iotcloud-robot). It listens for the
/// agent, passes frames on without decoding them, and sends commands back. A new agent that proves the token replaces
/// the one before, so that an agent need not wait for its old connection to end. The instance's metadata have `robot`:
/// `connected` or `away`, and `robot_listen`: the address.
class RobotLink final : public DepthSource, public Actuator {
 public:
  /// Listens at once. \throws std::runtime_error if it cannot; std::invalid_argument for a malformed address, and for
  /// one that needs a token.
  RobotLink(const LinkOptions& options, DriverContext& context);
  ~RobotLink() override;
  RobotLink(const RobotLink&) = delete;
  RobotLink& operator=(const RobotLink&) = delete;

  void start(std::function<void(const DepthFrame&)> on_frame) override;
  void stop() override;
  void answered() override;
  bool lock_step() const override { return lock_step_; }

  void drive(const Velocity& velocity) override;
  void halt() override;

 private:
  /// A connection whose other end has proved nothing yet.
  struct Guest {
    std::unique_ptr<Connection> connection;
    Hello hello;
    bool greeted = false;
    Nonce nonce{};
    HandlerId deadline = 0;
  };
  using Guests = std::list<Guest>;

  void accept();
  void receive(Guests::iterator guest, const Incoming& message);
  void greet(Guest& guest, const Incoming& message);
  void admit(Guests::iterator guest, const Proof& proof);
  void dismiss(Guests::iterator guest, const std::string& reason);
  void receive(const Incoming& message);
  void hand_over(const Incoming& message);
  void lose(const std::string& reason);

  const LinkOptions options_;
  DriverContext& context_;
  int listener_ = -1;
  HandlerId accepting_ = 0;
  Guests guests_;
  std::unique_ptr<Connection> robot_;  ///< nullptr while the robot is away
  std::string name_;
  std::function<void(const DepthFrame&)> on_frame_;  ///< empty while stopped
  std::uint64_t newest_ = 0;                         ///< number of the last frame from this connection
  bool lock_step_ = false;
  std::uint64_t connects_ = 0, dismissed_ = 0;
};

}  // namespace iotcloud::drivers::turtle::robot
