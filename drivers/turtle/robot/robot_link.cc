#include <algorithm>
#include <utility>

#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/turtle/options.h>
#include <iotcloud/drivers/turtle/robot/address.h>
#include <iotcloud/drivers/turtle/robot/robot_link.h>

namespace iotcloud::drivers::turtle::robot {

using std::chrono::milliseconds;

namespace {

constexpr std::size_t most_guests = 4;
constexpr std::chrono::seconds handshake_limit{3};
constexpr milliseconds least_silence{20}, most_silence{60'000};

milliseconds silence_of(std::uint32_t ms) {
  return std::clamp(milliseconds(ms), least_silence, most_silence);
}

}  // namespace

DeviceKind robot_kind() {
  DeviceKind kind;
  kind.name = "robot";
  kind.source = kind.actuator = kind.pair_only = true;
  kind.read = [](PropertyReader& reader, const TurtleOptions& common, DeviceParts) -> DeviceMaker {
    LinkOptions options;
    options.listen = reader.text("listen", options.listen);
    options.token = reader.text("token", options.token);
    options.silence = milliseconds(
        reader.integer("silence_ms", common.watchdog.count(), least_silence.count(), most_silence.count()));
    check_token(options.listen, options.token, "property \"token\"");
    return [options](DriverContext& context) {
      const auto link = std::make_shared<RobotLink>(options, context);
      return Device{link, link};
    };
  };
  return kind;
}

RobotLink::RobotLink(const LinkOptions& options, DriverContext& context) : options_(options), context_(context) {
  check_token(options_.listen, options_.token, "property \"token\"");
  listener_ = listen_at(options_.listen);
  accepting_ = context_.on_readable(listener_, [this] { accept(); });
  const std::string address = address_of(listener_);
  context_.update_metadata({{"robot", "away"}, {"robot_listen", address}});
  context_.log(LogLevel::info, "a robot's iotcloud-robot may connect to " + address);
}

RobotLink::~RobotLink() {
  context_.stop(accepting_);
  for (const Guest& guest : guests_) context_.stop(guest.deadline);
  close(listener_);
  context_.log(LogLevel::info, std::to_string(connects_) + " connections of a robot, " + std::to_string(dismissed_) +
                                   " others were dismissed");
}

void RobotLink::accept() {
  const int socket = accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (socket < 0) return;
  if (guests_.size() >= most_guests) {
    dismiss(guests_.begin(), "other connections came before it had proved that it knows the token");
  }
  const auto guest = guests_.emplace(guests_.end());
  guest->connection = std::make_unique<Connection>(
      context_, socket, handshake_limit,
      Connection::Handlers{[this, guest](const Incoming& message) { receive(guest, message); },
                           [this, guest](const std::string& reason) { dismiss(guest, reason); }});
  guest->deadline = context_.after(
      handshake_limit, [this, guest] { dismiss(guest, "it took too long to prove that it knows the token"); });
}

void RobotLink::dismiss(Guests::iterator guest, const std::string& reason) {
  context_.stop(guest->deadline);
  if (++dismissed_ == 1 || dismissed_ % 100 == 0) {
    context_.log(LogLevel::warn, "a connection to the robot's port was dismissed: " + reason + " (" +
                                     std::to_string(dismissed_) + " so far; not all are logged)");
  }
  guests_.erase(guest);
}

void RobotLink::receive(Guests::iterator guest, const Incoming& message) {
  if (message.kind == Kind::hello && !guest->greeted) {
    greet(*guest, message);
  } else if (message.kind == Kind::proof && guest->greeted) {
    admit(guest, read_proof(message));
  } else {
    throw ProtocolError("a message out of turn");
  }
}

void RobotLink::greet(Guest& guest, const Incoming& message) {
  try {
    guest.hello = read_hello(message);
  } catch (const ProtocolError& e) {
    guest.connection->send(write_refused(e.what()));
    throw;
  }
  guest.greeted = true;
  guest.nonce = random_nonce();
  Challenge challenge;
  challenge.silence_ms = static_cast<std::uint32_t>(options_.silence.count());
  challenge.nonce = guest.nonce;
  challenge.proof = make_proof(Side::driver, options_.token, guest.hello.nonce, guest.nonce);
  guest.connection->send(write_challenge(challenge));
}

void RobotLink::admit(Guests::iterator guest, const Proof& proof) {
  if (!same_proof(proof, make_proof(Side::agent, options_.token, guest->hello.nonce, guest->nonce))) {
    guest->connection->send(write_refused("the token is not the driver's"));
    throw ProtocolError("its token is not the driver's: check the property \"token\" and the agent's --token-file");
  }
  context_.stop(guest->deadline);
  const bool replaced = robot_ != nullptr;
  name_ = guest->hello.name;
  newest_ = 0;
  robot_ = std::move(guest->connection);
  robot_->establish(
      most_to_driver, options_.silence, silence_of(guest->hello.silence_ms),
      {[this](const Incoming& message) { receive(message); }, [this](const std::string& reason) { lose(reason); }});
  guests_.erase(guest);
  ++connects_;
  context_.log(LogLevel::info,
               "robot \"" + name_ + "\" is connected" + (replaced ? ", in place of an older connection" : ""));
  context_.update_metadata({{"robot", "connected"}});
  robot_->send(write_bare(on_frame_ ? Kind::start : Kind::stop));
}

void RobotLink::receive(const Incoming& message) {
  switch (message.kind) {
    case Kind::alive:
      return;
    case Kind::frame:
      return hand_over(message);
    default:
      throw ProtocolError("a message out of turn");
  }
}

void RobotLink::hand_over(const Incoming& message) {
  DepthFrame frame;
  const FrameHead head = read_frame(message, frame.encoded);
  robot_->send(write_number(Kind::got, head.number));
  frame.captured = std::chrono::steady_clock::now() - std::chrono::microseconds(head.age_us);
  frame.device_time_s = head.device_time_s;
  // A repeated frame that an earlier connection lost is new to this driver.
  frame.repeated = head.repeated && head.number == newest_;
  frame.truth = head.truth ? &*head.truth : nullptr;
  newest_ = head.number;
  lock_step_ = head.lock_step;
  const auto on_frame = on_frame_;  // a copy: the callback may stop the source
  if (on_frame) on_frame(frame);
}

void RobotLink::lose(const std::string& reason) {
  robot_.reset();
  context_.log(LogLevel::warn, "robot \"" + name_ + "\" is away: " + reason);
  context_.update_metadata({{"robot", "away"}});
}

void RobotLink::start(std::function<void(const DepthFrame&)> on_frame) {
  on_frame_ = std::move(on_frame);
  if (robot_) robot_->send(write_bare(Kind::start));
}

void RobotLink::stop() {
  on_frame_ = nullptr;
  if (robot_) robot_->send(write_bare(Kind::stop));
}

void RobotLink::answered() {
  if (robot_) robot_->send(write_number(Kind::answered, newest_));
}

void RobotLink::drive(const Velocity& velocity) {
  if (robot_) robot_->send(write_drive(velocity));
}

void RobotLink::halt() {
  if (robot_) robot_->send(write_bare(Kind::halt));
}

}  // namespace iotcloud::drivers::turtle::robot
