// A driver that sends messages with headers and looks at those of the answers.
#include <cstdint>
#include <fstream>
#include <set>
#include <string>

#include <nlohmann/json.hpp>

#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::drivers {
namespace {

/// Sends `count` messages on `data`: number N has N as its text and as its property `battery`, and the time
/// 1700000000000 + N. Awaits an answer to each on `control` with the same, and the property `reply` N. Writes what it
/// saw to the file `report` when every answer is there, and when it closes. `others`: messages with further properties.
class Courier final : public Driver {
 public:
  std::vector<ChannelSpec> channels(const PropertyMap& properties) override {
    PropertyReader reader(properties);
    count_ = reader.integer("count", 1, 1, 100'000);
    report_ = reader.text("report", "");
    const bool own_names = reader.flag("own_names", false);
    reader.finish();
    ChannelSpec data;
    data.name = "data";
    ChannelSpec control;
    control.name = "control";
    control.direction = Direction::in;
    for (ChannelSpec* channel : {&data, &control}) {
      if (!own_names) continue;
      channel->properties = {{"exchange", "courier_exchange"},
                             {"routingKey", channel->name + "_key"},
                             {"queueName", channel->name + "_queue"},
                             {"topic", channel->name + "_topic"}};
    }
    return {data, control};
  }
  void open(DriverContext& context) override { context_ = &context; }
  void activate() override { send(); }
  void on_writable(std::string_view) override { send(); }
  void close() override {
    if (context_ != nullptr) report();
  }

  void on_message(std::string_view, Message message) override {
    const std::string number(message.payload.text());
    const auto says = [&](const char* name) {
      const std::string* value = message.properties.find(name);
      return value != nullptr && *value == number;
    };
    if (message.driver_id != context_->instance_id() || message.gateway_id != context_->gateway_id() ||
        message.time_ms != first_time + std::stoll(number) || !says("battery") || !says("reply")) {
      ++wrong_;
    }
    if (message.properties.size() != 2) ++others_;
    if (!seen_.insert(number).second) ++twice_;
    if (static_cast<std::int64_t>(seen_.size()) == count_) report();
  }

 private:
  static constexpr std::int64_t first_time = 1'700'000'000'000;

  void send() {
    while (sent_ < count_) {
      Message message;
      const std::string number = std::to_string(sent_);
      message.payload = Payload::copy(number);
      message.time_ms = first_time + sent_;
      message.properties.set("battery", number);
      if (context_->publish("data", std::move(message)) != PublishStatus::accepted) return;
      ++sent_;
    }
  }
  void report() const {
    if (report_.empty()) return;
    std::ofstream(report_) << nlohmann::json{{"sent", sent_},
                                             {"received", seen_.size()},
                                             {"twice", twice_},
                                             {"wrong", wrong_},
                                             {"others", others_}}
                           << '\n';
  }

  DriverContext* context_ = nullptr;
  std::int64_t count_ = 1, sent_ = 0, twice_ = 0, wrong_ = 0, others_ = 0;
  std::string report_;
  std::set<std::string> seen_;
};

}  // namespace
}  // namespace iotcloud::drivers

IOTCLOUD_DRIVER(iotcloud::drivers::Courier, "courier", "1")
