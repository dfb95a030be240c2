#include <chrono>
#include <fstream>
#include <string>

#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/property_reader.h>

using namespace iotcloud::drivers;

/// Sends a temperature every `period_ms` and keeps the heater's orders that come back in the file `log`.
class Thermometer : public Driver {
 public:
  std::vector<ChannelSpec> channels(const PropertyMap& properties) override {
    PropertyReader reader(properties);
    period_ = std::chrono::milliseconds(reader.integer("period_ms", 20, 1, 60'000));
    log_file_ = reader.text("log", "/dev/null");
    reader.finish();  // a misspelt property is an error
    return {{.name = "reading", .direction = Direction::out, .when_full = WhenFull::block},
            {.name = "heater", .direction = Direction::in}};
  }

  void open(DriverContext& context) override {
    context_ = &context;
    log_.open(log_file_);
    context.every(period_, [this] { send(); });
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
  std::chrono::milliseconds period_{0};
  std::string log_file_;
  std::ofstream log_;
  bool active_ = false;
  int next_ = 0;
};

IOTCLOUD_DRIVER(Thermometer, "thermometer", "1.0")
