// A simulated vehicle: it drives in a circle, sends where it is, and says so in its metadata, too, by which others
// select it.
#include <array>
#include <chrono>
#include <cmath>
#include <string>

#include <fmt/format.h>

#include <iotcloud/drivers/plugin.h>

using namespace iotcloud::drivers;

class Vehicle : public Driver {
 public:
  static constexpr std::string_view description = "A simulated vehicle that drives in a circle";
  static constexpr std::array declared_properties{PropertySpec{.name = "latitude",
                                                               .type = PropertyType::number,
                                                               .min = -89,
                                                               .max = 89,
                                                               .default_value = "39.17",
                                                               .text = "of the circle's middle"},
                                                  PropertySpec{.name = "longitude",
                                                               .type = PropertyType::number,
                                                               .min = -180,
                                                               .max = 180,
                                                               .default_value = "-86.52",
                                                               .text = "of it"},
                                                  PropertySpec{.name = "radius",
                                                               .type = PropertyType::number,
                                                               .unit = "m",
                                                               .min = 0,
                                                               .max = 50'000,
                                                               .default_value = "300",
                                                               .text = "of the circle"},
                                                  PropertySpec{.name = "phase",
                                                               .type = PropertyType::number,
                                                               .default_value = "0",
                                                               .text = "where on the circle it begins, in turns"}};

  std::vector<ChannelSpec> channels(const PropertyMap&) override {
    ChannelSpec position;
    position.name = "position";
    position.when_full = WhenFull::keep_newest;  // a stale one is worth nothing
    return {position};
  }
  void open(DriverContext& context) override {
    context_ = &context;
    latitude_ = context.number("latitude");
    longitude_ = context.number("longitude");
    radius_ = context.number("radius");
    turns_ = context.number("phase");
    context.every(std::chrono::milliseconds(200), [this] { drive(); });
    context.every(std::chrono::seconds(5), [this] { tell(); });
    tell();
  }
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }

 private:
  std::string place() const {
    constexpr double metres_in_degree = 111'195, full = 6.283185307179586;
    const double north = radius_ * std::sin(turns_ * full), east = radius_ * std::cos(turns_ * full);
    return fmt::format("{:.6f},{:.6f}", latitude_ + north / metres_in_degree,
                       longitude_ + east / (metres_in_degree * std::cos(latitude_ * full / 360)));
  }
  void drive() {
    turns_ += 0.002;
    if (active_) context_->publish("position", Payload::copy(place()));
  }
  void tell() { context_->update_metadata({{"location", place()}}); }

  DriverContext* context_ = nullptr;
  double latitude_ = 0, longitude_ = 0, radius_ = 0, turns_ = 0;
  bool active_ = false;
};

IOTCLOUD_DRIVER(Vehicle, "vehicle", "1.0")
