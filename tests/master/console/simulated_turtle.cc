#include <cstdint>
#include <cstdlib>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <openssl/evp.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/turtle/simulator/world.h>
#include <iotcloud/examples/turtlebot_follower/follower.h>
#include <iotcloud/tests/master/console/simulated_turtle.h>

namespace iotcloud::master {

namespace {

using Json = nlohmann::json;
namespace depth = drivers::depth;
namespace turtle = drivers::turtle;

constexpr int rate = 30, frames_of_a_step = 8;
constexpr std::int64_t begun_ms = 1'790'000'000'000, frame_ms = 1000 / rate;

std::string base64(const std::string& bytes) {
  std::string text(4 * ((bytes.size() + 2) / 3) + 1, '\0');
  const int length =
      EVP_EncodeBlock(reinterpret_cast<unsigned char*>(text.data()),
                      reinterpret_cast<const unsigned char*>(bytes.data()), static_cast<int>(bytes.size()));
  text.resize(static_cast<std::size_t>(length));
  return text;
}

}  // namespace

struct SimulatedTurtle::Impl {
  config::Mutex mutex;
  turtle::simulator::World world{7};
  const turtlebot_follower::Follower follower;
  depth::DepthEncoder encoder{depth::Codec::compact};
  depth::DepthDecoder decoder;
  std::vector<std::uint16_t> disparities = std::vector<std::uint16_t>(depth::frame_pixels),
                             mm = std::vector<std::uint16_t>(depth::frame_pixels);
  std::string payload;  ///< the newest frame, compressed
  std::int64_t frames = 0, bytes = 0;
  Json commands = Json::array();

  std::string truth() const {
    const auto is = world.truth();
    return fmt::format("{:.3f},{:.3f},{:.4f},{:.3f},{:.3f},{:.3f}", is.robot_x, is.robot_y, is.robot_heading,
                       is.person_x, is.person_y, is.distance);
  }

  /// What its camera sees now, which each look sees until the world moves on.
  void capture() {
    world.render(depth::FrameSpan(disparities));
    const auto bytes_of_it = encoder.encode(depth::FrameView(disparities));
    payload.assign(reinterpret_cast<const char*>(bytes_of_it.data()), bytes_of_it.size());
    if (decoder.decode(bytes_of_it, depth::FrameSpan(mm)) != depth::DecodeError::none) std::abort();
  }

  /// Of the millimetres that C++ decodes, each with its place's weight.
  std::uint32_t sum() const {
    std::uint32_t sum = 0;
    for (std::size_t i = 0; i < mm.size(); ++i) sum += mm[i] * static_cast<std::uint32_t>(i % 1000);
    return sum;
  }

  Json message(std::int64_t number, std::size_t size, std::string content, Json properties) const {
    return {{"number", number}, {"seen_ms", begun_ms + number * frame_ms}, {"time_ms", begun_ms + number * frame_ms},
            {"size", size},     {"payload", std::move(content)},           {"properties", std::move(properties)}};
  }

  Json next_frame() {
    world.advance_to(static_cast<double>(++frames) / rate);
    capture();
    bytes += static_cast<std::int64_t>(payload.size());
    const auto [linear, angular] = follower.compute(mm).velocity;
    world.command({linear, angular});
    const auto command = turtlebot_follower::to_json({linear, angular});
    commands.push_back(message(frames, command.size(), base64(command), Json::object()));
    if (commands.size() > 64) commands.erase(0);
    return message(frames, payload.size(), "",
                   {{"seq", std::to_string(frames)},
                    {"truth", truth()},
                    {"answers", fmt::format("{}:{}", frames - 1, 700 + (frames * 37) % 400)}});
  }
};

SimulatedTurtle::SimulatedTurtle() : impl_(std::make_unique<Impl>()) {
  impl_->capture();
}
SimulatedTurtle::~SimulatedTurtle() = default;

std::string SimulatedTurtle::look(const Json& look) {
  const config::MutexLock lock(impl_->mutex);
  Json messages = Json::array();
  if (look.at("channel") == "control") {
    messages = std::exchange(impl_->commands, Json::array());
  } else if (look.at("bytes") == 0) {
    for (int step = 0; step < frames_of_a_step; ++step) messages.push_back(impl_->next_frame());
  } else {
    messages.push_back(impl_->message(
        impl_->frames, impl_->payload.size(), base64(impl_->payload),
        {{"seq", std::to_string(impl_->frames)}, {"truth", impl_->truth()}, {"sum", std::to_string(impl_->sum())}}));
  }
  return Json{{"state", "active"},
              {"elapsed_us", impl_->frames * 1'000'000 / rate},
              {"count", impl_->frames},
              {"bytes", impl_->bytes},
              {"missed", 0},
              {"channels", Json::array()},
              {"messages", messages}}
      .dump();
}

}  // namespace iotcloud::master
