#include <algorithm>
#include <tuple>
#include <utility>

#include <iotcloud/drivers/turtle/robot/address.h>
#include <iotcloud/drivers/turtle/robot/agent.h>

namespace iotcloud::drivers::turtle::robot {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

Agent::Agent(boost::asio::io_context& loop, AgentOptions options, const TurtleOptions& turtle, DriverContext& context)
    : loop_(loop),
      options_(std::move(options)),
      turtle_(turtle),
      context_(context),
      device_(turtle_.make_device(context)),
      encoder_(turtle_.codec),
      wait_(options_.reconnect) {}

Agent::~Agent() {
  stop();
}

void Agent::start() {
  running_ = true;
  connect();
}

void Agent::stop() {
  if (!std::exchange(running_, false)) return;
  if (retry_) context_.stop(*retry_);
  retry_.reset();
  session_.reset();
  pause_source();
  if (watchdog_) context_.stop(*watchdog_);
  watchdog_.reset();
  device_.actuator->halt();
  context_.log(LogLevel::info, std::to_string(counts_.frames) + " frames, " + std::to_string(counts_.sent) + " sent, " +
                                   std::to_string(counts_.superseded) + " superseded, " +
                                   std::to_string(counts_.unwanted) + " while no driver was connected; " +
                                   std::to_string(counts_.commands) + " commands; " + std::to_string(counts_.connects) +
                                   " connections, " + std::to_string(counts_.lost) + " of them lost; " +
                                   std::to_string(counts_.watchdog_stops) + " stops by the watchdog, " +
                                   std::to_string(counts_.link_stops) + " with a connection");
}

void Agent::connect() {
  retry_.reset();
  ++counts_.attempts;
  SessionOptions session;
  std::tie(session.host, session.port) = split_address(options_.driver);
  session.token = options_.token;
  session.name = options_.name;
  session.silence = options_.silence;
  session.handshake = options_.handshake;
  const auto on_open = [this] {
    ++counts_.connects;
    told_lost_ = false;
    wait_ = options_.reconnect;
    under_way_ = 0;
    wanted_ = false;
    context_.log(LogLevel::info, "connected to the driver at " + options_.driver);
  };
  session_ = std::make_unique<Session>(loop_, session,
                                       Session::Handlers{on_open, [this](const Incoming& message) { receive(message); },
                                                         [this](const std::string& reason) { lose(reason); }});
}

void Agent::lose(const std::string& reason) {
  session_.reset();
  if (std::exchange(wanted_, false)) {
    ++counts_.lost;
    ++counts_.link_stops;
    device_.actuator->halt();
  }
  if (watchdog_) context_.stop(*watchdog_);
  watchdog_.reset();
  waiting_.full = false;
  if (!std::exchange(told_lost_, true)) {
    context_.log(LogLevel::warn, "no connection to the driver at " + options_.driver + ": " + reason +
                                     ". The agent tries again until there is one");
  }
  // Random, so that robots that lost the same gateway do not all come back at once.
  const auto wait =
      milliseconds(std::uniform_int_distribution<milliseconds::rep>(wait_.count() / 2, wait_.count())(random_));
  wait_ = std::min(2 * wait_, options_.longest_wait);
  retry_ = context_.after(wait, [this] { connect(); });
}

void Agent::receive(const Incoming& message) {
  switch (message.kind) {
    case Kind::alive:
      return;
    case Kind::start:
      wanted_ = true;
      if (!std::exchange(source_runs_, true)) device_.source->start([this](const DepthFrame& frame) { take(frame); });
      return;
    case Kind::stop:
      wanted_ = false;
      pause_source();
      device_.actuator->halt();
      return;
    case Kind::got:
      read_number(message);
      under_way_ = std::max(0, under_way_ - 1);
      return send_newest();
    case Kind::drive:
      return drive(read_drive(message));
    case Kind::halt:
      device_.actuator->halt();
      return;
    case Kind::answered:
      if (read_number(message) == number_ && source_runs_) device_.source->answered();
      return;
    default:
      throw ProtocolError("a message that a driver does not send");
  }
}

void Agent::pause_source() {
  waiting_.full = false;
  if (std::exchange(source_runs_, false)) device_.source->stop();
}

void Agent::take(const DepthFrame& frame) {
  if (!frame.disparities) {
    return context_.fail("this source sends frames that are compressed already: run the agent where they are taken");
  }
  ++counts_.frames;
  if (!frame.repeated) ++number_;
  if (!wanted_) {
    ++counts_.unwanted;
    return;
  }
  if (waiting_.full) ++counts_.superseded;
  std::copy(frame.disparities->begin(), frame.disparities->end(), waiting_.disparities.begin());
  waiting_.head.number = number_;
  waiting_.head.device_time_s = frame.device_time_s;
  waiting_.head.repeated = frame.repeated;
  waiting_.head.lock_step = device_.source->lock_step();
  waiting_.head.truth = frame.truth ? std::optional(*frame.truth) : std::nullopt;
  waiting_.captured = frame.captured;
  waiting_.full = true;
  send_newest();
}

/// Encodes a frame only when it can be sent: frames that a newer one supersedes cost nothing.
void Agent::send_newest() {
  if (!waiting_.full || !wanted_ || under_way_ >= options_.in_flight) return;
  waiting_.full = false;
  ++under_way_;
  ++counts_.sent;
  Payload encoded = Payload::copy(encoder_.encode(depth::FrameView(waiting_.disparities)));
  const auto age =
      std::chrono::duration_cast<std::chrono::microseconds>(steady_clock::now() - waiting_.captured).count();
  waiting_.head.age_us = static_cast<std::uint32_t>(std::clamp<std::int64_t>(age, 0, UINT32_MAX));
  std::string head = write_frame_head(waiting_.head, encoded.size());
  session_->send(std::move(head), std::move(encoded));
}

void Agent::drive(const Velocity& velocity) {
  ++counts_.commands;
  device_.actuator->drive(velocity);
  // In lock step the world, and the robot with it, stands still until a command comes.
  if (!device_.source->lock_step()) arm_watchdog();
}

void Agent::arm_watchdog() {
  if (watchdog_) context_.stop(*watchdog_);
  watchdog_ = context_.after(turtle_.watchdog, [this] {
    watchdog_.reset();
    ++counts_.watchdog_stops;
    device_.actuator->halt();
    context_.log(LogLevel::warn, "no command for " + std::to_string(turtle_.watchdog.count()) +
                                     " ms: the robot is stopped until the next one");
  });
}

}  // namespace iotcloud::drivers::turtle::robot
