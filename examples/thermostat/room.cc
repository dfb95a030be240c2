// A simulated room: it sends its temperature ten times a second, and is warmed while its heater is on.
#include <array>
#include <chrono>
#include <string>

#include <fmt/format.h>

#include <iotcloud/drivers/plugin.h>

using namespace iotcloud::drivers;

class Room : public Driver {
 public:
  static constexpr std::string_view description = "A simulated room with a thermometer and a heater";
  static constexpr std::array declared_properties{PropertySpec{.name = "start",
                                                               .type = PropertyType::number,
                                                               .unit = "C",
                                                               .min = -50,
                                                               .max = 100,
                                                               .default_value = "15",
                                                               .text = "the temperature at the beginning"}};

  std::vector<ChannelSpec> channels(const PropertyMap&) override {
    ChannelSpec temperature, heater;
    temperature.name = "temperature";
    temperature.when_full = WhenFull::keep_newest;  // a stale one is worth nothing
    heater.name = "heater";
    heater.direction = Direction::in;
    heater.priority = 5;  // orders overtake readings
    return {temperature, heater};
  }
  void open(DriverContext& context) override {
    context_ = &context;
    degrees_ = context.number("start");
    context.every(std::chrono::milliseconds(100), [this] { pass(); });
  }
  void activate() override { active_ = true; }
  void deactivate() override { active_ = heated_ = false; }
  void on_message(std::string_view, Message message) override { heated_ = message.payload.text() == "on"; }

 private:
  void pass() {
    degrees_ += heated_ ? 0.2 : -0.1;
    if (active_) context_->publish("temperature", Payload::copy(fmt::format("{:.1f}", degrees_)));
  }

  DriverContext* context_ = nullptr;
  double degrees_ = 0;
  bool heated_ = false, active_ = false;
};

IOTCLOUD_DRIVER(Room, "room", "1.0")
