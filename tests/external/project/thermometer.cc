#include <fstream>
#include <string>

#include <iotcloud/drivers/plugin.h>

using iotcloud::drivers::ChannelSpec;
using iotcloud::drivers::Direction;
using iotcloud::drivers::Driver;
using iotcloud::drivers::DriverContext;
using iotcloud::drivers::Message;
using iotcloud::drivers::Payload;
using iotcloud::drivers::PropertyMap;

/// Sends a temperature every 20 ms and keeps the heater's orders that come back in the file of property `log`.
class Thermometer : public Driver {
 public:
  std::vector<ChannelSpec> channels(const PropertyMap&) override {
    return {{.name = "reading", .direction = Direction::out}, {.name = "heater", .direction = Direction::in}};
  }
  void open(DriverContext& context) override {
    context_ = &context;
    log_.open(context.property("log", "/dev/null"));
    context.every(std::chrono::milliseconds(20), [this] { send(); });
  }
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }
  void on_message(std::string_view, Message message) override {
    log_ << context_->instance_id() << ' ' << message.driver_id << ' ' << message.payload.text() << std::endl;
  }

 private:
  void send() {
    if (active_) context_->publish("reading", Payload::copy(std::to_string(15 + count_++ % 10)));
  }
  DriverContext* context_ = nullptr;
  std::ofstream log_;
  bool active_ = false;
  int count_ = 0;
};

IOTCLOUD_DRIVER(Thermometer, "thermometer", "1.0")
