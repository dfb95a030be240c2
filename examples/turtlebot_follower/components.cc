#include <memory>
#include <set>
#include <string>

#include <iotcloud/config/log.h>
#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/examples/turtlebot_follower/follower.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/conf_keys.h>
#include <iotcloud/topology/plugin.h>

namespace turtlebot_follower {

namespace depth = iotcloud::drivers::depth;
using iotcloud::topology::BasicBolt;
using iotcloud::topology::BasicOutputCollector;
using iotcloud::topology::Config;
using iotcloud::topology::Fields;
using iotcloud::topology::OutputFieldsDeclarer;
using iotcloud::topology::Payload;
using iotcloud::topology::TopologyContext;
using iotcloud::topology::Tuple;
using iotcloud::topology::Values;

namespace {

const iotcloud::config::Logger logger{"turtlebot_follower"};

}  // namespace

/// In: frame (of any codec of drivers/depth), driverID, time. Out: depth (640x480 millimetres, 16 bits each), driverID,
/// time.
class Decoder : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"depth", "driverID", "time"});
  }
  static void check_conf(const Config& config) {
    iotcloud::topology::ConfCheck check;
    check.refuse_unknown_keys(config, "", {});
    check.finish();
  }
  void prepare(const Config&, const TopologyContext& context) override {
    bad_frames_ = &context.metrics->counter("turtlebot_bad_frames_total", "Frames that could not be decoded",
                                            {{"topology", context.topology}});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    // The follower's task shares it, so each frame has its own memory; the decoder writes every pixel.
    const auto mm = std::make_shared_for_overwrite<std::uint16_t[]>(depth::frame_pixels);
    const auto error =
        decoder_.decode(tuple.get<Payload>("frame").bytes(), depth::FrameSpan(mm.get(), depth::frame_pixels));
    if (error != depth::DecodeError::none) {
      note_bad(tuple.get<std::string>("driverID"), error);
      return;
    }
    if (!in_bad_burst_.empty()) in_bad_burst_.erase(tuple.get<std::string>("driverID"));
    const auto bytes = std::as_bytes(std::span(mm.get(), depth::frame_pixels));
    collector.emit(Values(Payload::wrap(mm, bytes), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  void note_bad(const std::string& driver, depth::DecodeError error) {
    bad_frames_->add();
    if (in_bad_burst_.size() >= most_remembered) in_bad_burst_.clear();
    if (!in_bad_burst_.insert(driver).second) return;
    logger.warn("a frame of driver {} is refused: {}; further ones are only counted until a good one comes", driver,
                depth::describe(error));
  }

  static constexpr std::size_t most_remembered = 1000;
  depth::DepthDecoder decoder_;  // one for all drivers, because every frame stands for itself
  iotcloud::config::Counter* bad_frames_ = nullptr;
  std::set<std::string> in_bad_burst_;  ///< drivers whose newest frame was bad
};

/// In: depth, driverID, time. Out: control (a velocity as JSON), driverID, time.
class Follow : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"control", "driverID", "time"});
  }
  static void check_conf(const Config& config) { static_cast<void>(read_options(config)); }
  void prepare(const Config& config, const TopologyContext&) override { follower_ = Follower(read_options(config)); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const Payload& depth_mm = tuple.get<Payload>("depth");
    const std::span pixels(reinterpret_cast<const std::uint16_t*>(depth_mm.data()), depth_mm.size() / 2);
    const Velocity velocity = follower_.compute(pixels).velocity;
    collector.emit(Values(Payload::take(to_json(velocity)), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  Follower follower_;
};

}  // namespace turtlebot_follower

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<turtlebot_follower::Decoder>("turtlebot.Decoder");
  registry.add_bolt<turtlebot_follower::Follow>("turtlebot.Follow");
}
