#include <exception>
#include <string>
#include <utility>

#include <iotcloud/drivers/camera/camera_driver.h>

namespace iotcloud::drivers::camera {

namespace {

constexpr int ticks_of_silence = 4;

}  // namespace

std::vector<ChannelSpec> CameraDriver::channels(const PropertyMap& properties) {
  constexpr std::size_t frames_that_wait = 8;
  options_ = read_options(properties);
  ChannelSpec frames;
  frames.name = frames_channel;
  frames.broker = options_.broker;
  frames.when_full = WhenFull::keep_newest;
  frames.capacity = frames_that_wait;
  return {frames};
}

void CameraDriver::open(DriverContext& context) {
  context_ = &context;
  too_long_.emplace(context);
  left_out_.emplace(context);
  retry_.emplace(context, options_.pauses);
  state_.emplace(context);
  context.update_metadata({{"camera", options_.source}});
}

void CameraDriver::activate() {
  active_ = true;
  connect();
}

void CameraDriver::deactivate() {
  active_ = false;
  disconnect();
  retry_.emplace(*context_, options_.pauses);
  state_->away("it is closed while the instance is stopped");
}

void CameraDriver::close() {
  disconnect();
  retry_.reset();
}

void CameraDriver::connect() {
  Pipeline::Handlers handlers;
  handlers.on_frames = [this] { take_frames(); };
  handlers.on_end = [this](bool failed, const std::string& reason) { ended(failed, reason); };
  needs_key_ = options_.h264;
  heard_ = at_end_ = false;
  silent_ticks_ = 0;
  try {
    pipeline_ = std::make_unique<Pipeline>(*context_, options_, std::move(handlers));
  } catch (const std::exception& e) {
    return ended(true, e.what());
  }
  if (options_.silence.count() == 0) return;
  auto silence = std::chrono::duration_cast<std::chrono::microseconds>(options_.silence);
  constexpr double two_periods_us = 2e6;
  if (options_.rate > 0)
    silence += std::chrono::microseconds(static_cast<std::int64_t>(two_periods_us / options_.rate));
  ticks_ = context_->every(silence / ticks_of_silence, [this] { tick(); });
}

void CameraDriver::disconnect() {
  if (ticks_) context_->stop(*std::exchange(ticks_, std::nullopt));
  pipeline_.reset();
  waiting_.reset();
}

void CameraDriver::ended(bool failed, const std::string& reason) {
  if (!failed && waiting_) {  // the file's last frame, for which the channel has no room yet
    at_end_ = true;
    return;
  }
  const bool had_frames = heard_;
  disconnect();
  if (!failed && options_.kind == SourceKind::file && had_frames) {
    if (!options_.loop) return state_->away("the file has been played to its end (loop is false)");
    return context_->post([this] {
      if (active_ && !pipeline_) connect();
    });
  }
  state_->away(options_.source + ": " + reason);
  retry_->later([this] { connect(); });
}

void CameraDriver::tick() {
  if (full_ || ++silent_ticks_ <= ticks_of_silence) return;
  ended(true, "no frame has come for silence_ms");
}

void CameraDriver::take_frames() {
  while (pipeline_ && !(waiting_ && !options_.is_live())) {
    auto frame = pipeline_->take();
    if (!frame) return;
    take(std::move(*frame));
  }
}

void CameraDriver::take(Frame frame) {
  silent_ticks_ = 0;
  heard_ = true;
  if (frame.width != width_ || frame.height != height_ || !state_->is_there()) {
    width_ = frame.width;
    height_ = frame.height;
    retry_->reached();
    state_->connected(
        {{"frames", (options_.h264 ? "h264 " : "jpeg ") + std::to_string(width_) + "x" + std::to_string(height_)}});
  }
  if (frame.payload.size() > options_.most_bytes) {
    needs_key_ = options_.h264;
    return too_long_->warn("a frame of " + std::to_string(frame.payload.size()) + " bytes is longer than most_bytes");
  }
  if (needs_key_ && !frame.key) return;
  needs_key_ = false;
  if (!full_ && publish(frame)) return;
  full_ = true;
  if (options_.is_live() && (waiting_ || options_.h264))
    left_out_->warn("a frame is left out, because the channel is full");
  if (options_.is_live() && options_.h264) {
    needs_key_ = true;
  } else {
    waiting_ = std::move(frame);
  }
}

bool CameraDriver::publish(const Frame& frame) {
  Message message;
  message.payload = frame.payload;
  message.time_ms = frame.time_ms;
  message.properties.set(format_property, options_.h264 ? "h264" : "jpeg");
  message.properties.set(width_property, std::to_string(frame.width));
  message.properties.set(height_property, std::to_string(frame.height));
  if (frame.position_ms) message.properties.set(position_property, std::to_string(*frame.position_ms));
  if (options_.h264) message.properties.set(key_property, frame.key ? "true" : "false");
  return context_->publish(frames_channel, std::move(message)) != PublishStatus::would_block;
}

void CameraDriver::on_writable(std::string_view /*channel*/) {
  full_ = false;
  if (waiting_) {
    if (!publish(*waiting_)) {
      full_ = true;
      return;
    }
    waiting_.reset();
  }
  if (at_end_) return ended(false, "");
  take_frames();
}

}  // namespace iotcloud::drivers::camera
