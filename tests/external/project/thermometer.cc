#include <array>
#include <chrono>
#include <fstream>
#include <string>

#include <iotcloud/drivers/plugin.h>

using namespace iotcloud::drivers;

/// Sends a temperature every `period_ms` and keeps the heater's orders that come back in the file `log`.
class Thermometer : public Driver {
 public:
  static constexpr std::string_view description = "A simulated thermometer, and a heater that obeys";
  static constexpr std::array declared_properties{
      PropertySpec{.name = "period_ms",
                   .type = PropertyType::integer,
                   .unit = "ms",
                   .min = 1,
                   .max = 60'000,
                   .default_value = "20",
                   .text = "time between two readings"},
      PropertySpec{.name = "log", .default_value = "/dev/null", .text = "file of the heater's orders"}};

  std::vector<ChannelSpec> channels(const PropertyMap&) override {
    return {{.name = "reading", .direction = Direction::out, .when_full = WhenFull::block},
            {.name = "heater", .direction = Direction::in}};
  }

  void open(DriverContext& context) override {
    context_ = &context;
    log_.open(context.property("log"));
    context.every(std::chrono::milliseconds(context.integer("period_ms")), [this] { send(); });
  }
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }

  void on_message(std::string_view, Message message) override {
    log_ << context_->instance_id() << ' ' << message.driver_id << ' ' << message.payload.text() << std::endl;
  }

 private:
  void send() {
    if (!active_) return;
    // A reading that the channel has no room for is sent the next time.
    const auto status = context_->publish("reading", Payload::copy(std::to_string(15 + next_ % 10)));
    if (status == PublishStatus::accepted) ++next_;
  }

  DriverContext* context_ = nullptr;
  std::ofstream log_;
  bool active_ = false;
  int next_ = 0;
};

IOTCLOUD_DRIVER(Thermometer, "thermometer", "1.0")
