#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <utility>

#include <iotcloud/drivers/turtle/command.h>
#include <iotcloud/drivers/turtle/turtle_driver.h>

namespace iotcloud::drivers::turtle {

using std::chrono::steady_clock;

namespace {

constexpr std::size_t most_answers_bytes = 256;
constexpr double position_step = 0.25;        // metres; smaller moves do not change the record
constexpr std::chrono::seconds burst_gap{5};  // a malformed command is logged if the one before was longer ago

std::int64_t wall_ms() {
  return std::chrono::duration_cast<std::chrono::milliseconds>(std::chrono::system_clock::now().time_since_epoch())
      .count();
}

double microseconds(steady_clock::duration duration) {
  return std::chrono::duration<double, std::micro>(duration).count();
}

/// As the property "truth" has it.
std::string text_of(const GroundTruth& truth) {
  std::array<char, 128> text{};
  std::snprintf(text.data(), text.size(), "%.3f,%.3f,%.4f,%.3f,%.3f,%.3f", truth.robot_x, truth.robot_y,
                truth.robot_heading, truth.person_x, truth.person_y, truth.distance);
  return text.data();
}

}  // namespace

std::vector<ChannelSpec> TurtleDriver::channels(const PropertyMap& properties) {
  const TurtleOptions options = read_options(properties, kinds_);
  ChannelSpec frames;
  frames.name = frames_channel;
  frames.direction = Direction::out;
  frames.broker = options.broker;
  // A robot steers by the present, so the newest frame replaces older ones.
  frames.when_full = WhenFull::keep_newest;
  frames.capacity = 2;
  frames.deadline = std::chrono::milliseconds(200);
  ChannelSpec control;
  control.name = control_channel;
  control.direction = Direction::in;
  control.broker = options.broker;
  control.keep_last = 1;
  control.priority = 9;  // a command never waits behind frames
  return {frames, control};
}

void TurtleDriver::open(DriverContext& context) {
  context_ = &context;
  options_ = read_options(context.properties(), kinds_);
  encoder_ = depth::DepthEncoder(options_.codec);
  device_ = options_.make_device(context);
  if (!options_.trace.empty()) log_.open_trace(options_.trace);
  log_.set_origin(steady_clock::now());
}

void TurtleDriver::activate() {
  if (!std::exchange(opened_once_, true)) log_.set_origin(steady_clock::now());
  active_ = true;
  device_.source->start([this](const DepthFrame& frame) { send(frame); });
}

void TurtleDriver::deactivate() {
  active_ = false;
  device_.source->stop();
  if (watchdog_) context_->stop(*watchdog_);
  watchdog_.reset();
  device_.actuator->halt();
}

void TurtleDriver::close() {
  if (active_) deactivate();
  device_ = {};  // here, while its last messages can still be logged
  log_.close();
  if (context_) sum_up();
}

void TurtleDriver::send(const DepthFrame& frame) {
  if (options_.frames != 0 && sequence_ == options_.frames && !frame.repeated) {
    device_.source->stop();
    return;
  }
  const auto started = steady_clock::now();
  const Payload payload = frame.disparities ? Payload::copy(encoder_.encode(*frame.disparities)) : frame.encoded;
  const auto encoded = steady_clock::now();
  if (frame.repeated && sequence_ > 0) {
    log_.repeat_newest(frame.captured, publish(sequence_ - 1, last_time_ms_, frame, payload));
    return;
  }
  last_time_ms_ = std::max(last_time_ms_ + 1, wall_ms());
  FrameRecord record;
  record.sequence = sequence_++;
  record.time_ms = last_time_ms_;
  record.captured = frame.captured;
  record.device_time_s = frame.device_time_s;
  if (frame.truth) {
    record.truth = *frame.truth;
    tell_position(*frame.truth);
  }
  record.encode_us = microseconds(encoded - started);
  record.payload_bytes = payload.size();
  record.published = publish(record.sequence, record.time_ms, frame, payload);
  log_.add(record);
  log_.tidy(steady_clock::now());
}

/// Updates the record, so that topologies can choose robots by their place.
void TurtleDriver::tell_position(const GroundTruth& truth) {
  if (told_ && std::hypot(truth.robot_x - told_->first, truth.robot_y - told_->second) < position_step) return;
  told_ = {truth.robot_x, truth.robot_y};
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "%.2f,%.2f", truth.robot_x, truth.robot_y);
  context_->update_metadata({{"position", text.data()}});
}

/// What a page for people shows beside the frames: it sees messages only.
void TurtleDriver::note_answer(const FrameRecord& record) {
  if (answers_.size() > most_answers_bytes) return;  // no frame was sent for long
  if (!answers_.empty()) answers_ += ' ';
  answers_ += std::to_string(record.sequence) + ':' + std::to_string(record.latency.count());
}

PublishStatus TurtleDriver::publish(std::uint64_t sequence, std::int64_t time_ms, const DepthFrame& frame,
                                    Payload payload) {
  Message message;
  message.payload = std::move(payload);
  message.time_ms = time_ms;
  message.properties.set("seq", std::to_string(sequence));
  if (frame.truth) message.properties.set("truth", text_of(*frame.truth));
  if (!answers_.empty()) message.properties.set("answers", std::exchange(answers_, {}));
  return context_->publish(frames_channel, std::move(message));
}

void TurtleDriver::on_message(std::string_view channel, Message message) {
  const auto arrived = steady_clock::now();
  if (channel != control_channel) return;
  const auto command = parse_command(message.payload.text());
  if (!command) {
    note_malformed(arrived);
    return;
  }
  if (!active_) return;
  device_.actuator->drive(*command);
  guard_robot();
  const bool newest = log_.newest_is(message.time_ms);
  const FrameRecord* const answered = log_.answer(message.time_ms, *command, arrived);
  if (answered == nullptr) return;
  note_answer(*answered);
  if (newest) device_.source->answered();
}

void TurtleDriver::guard_robot() {
  // In lock step the world, and the robot with it, stands still until a command comes.
  if (device_.source->lock_step()) return;
  if (watchdog_) context_->stop(*watchdog_);
  watchdog_ = context_->after(options_.watchdog, [this] {
    watchdog_.reset();
    ++watchdog_stops_;
    device_.actuator->halt();
    context_->log(LogLevel::warn, "no command for " + std::to_string(options_.watchdog.count()) +
                                      " ms: the robot is stopped until the next one");
  });
}

void TurtleDriver::note_malformed(Instant now) {
  if (malformed_++ == 0 || now - last_malformed_ > burst_gap) {
    context_->log(LogLevel::warn,
                  "a command that is not {\"linear\":{\"x\":..},\"angular\":{\"z\":..}} is ignored, as are others like "
                  "it that follow; so far: " +
                      std::to_string(malformed_));
  }
  last_malformed_ = now;
}

void TurtleDriver::sum_up() {
  const FrameLog::Totals& totals = log_.totals();
  std::vector<std::uint32_t> latencies = totals.latencies_us;
  std::string text = std::to_string(totals.frames) + " frames, " + std::to_string(totals.answered) + " answered, " +
                     std::to_string(totals.refused) + " not taken by the channel, " + std::to_string(malformed_) +
                     " malformed commands, " + std::to_string(watchdog_stops_) + " stops by the watchdog";
  if (!latencies.empty()) {
    std::sort(latencies.begin(), latencies.end());
    const auto at = [&](double share) {
      return std::to_string(latencies[static_cast<std::size_t>(share * static_cast<double>(latencies.size() - 1))]);
    };
    text += "; frame to command p50 " + at(0.5) + " us, p99 " + at(0.99) + " us, max " + at(1) + " us";
  }
  context_->log(LogLevel::info, text);
  if (log_.trace_failed()) context_->log(LogLevel::error, "the trace \"" + options_.trace + "\" is not complete");
}

}  // namespace iotcloud::drivers::turtle
