// A driver that keeps accounts: each message on `data` has its own number, written to FOLDER/sent as soon as the
// channel has accepted the message, and to FOLDER/received when it comes back on `echo`. Its next run continues where
// the killed one stopped, so the accounts of all runs together show what was lost. While a file FOLDER/pause is there
// it sends nothing and still takes what comes back. Properties: `folder`, which gets a FOLDER for each gateway, `rate`
// (per second).
#include <algorithm>
#include <charconv>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

#include <iotcloud/drivers/plugin.h>

namespace {

namespace drivers = iotcloud::drivers;

class Ledger final : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override {
    drivers::ChannelSpec data, echo;
    data.name = "data";
    data.durable = true;
    data.when_full = drivers::WhenFull::spool;
    echo.name = "echo";
    echo.direction = drivers::Direction::in;
    echo.durable = true;
    return {data, echo};
  }

  void open(drivers::DriverContext& context) override {
    context_ = &context;
    const std::filesystem::path folder = std::filesystem::path(context.property("folder", "")) / context.gateway_id();
    std::filesystem::create_directories(folder);
    pause_ = folder / "pause";
    next_ = last_line(folder / "sent") + 1;
    sent_.open(folder / "sent", std::ios::app);
    received_.open(folder / "received", std::ios::app);
    if (!sent_ || !received_) throw std::runtime_error("cannot write to \"" + folder.string() + "\"");
  }
  void activate() override {
    const auto rate = std::max<std::int64_t>(1, context_->integer("rate", 100));
    timer_ = context_->every(std::chrono::microseconds(1'000'000 / rate), [this] { send(); });
  }
  void deactivate() override { context_->stop(timer_); }
  void on_message(std::string_view, drivers::Message message) override { write(received_, message.payload.text()); }

 private:
  static std::uint64_t last_line(const std::filesystem::path& file) {
    std::ifstream in(file);
    std::uint64_t number = 0;
    for (std::string line; std::getline(in, line);) std::from_chars(line.data(), line.data() + line.size(), number);
    return number;
  }
  /// Writes a line with one write(2), so that it survives kill -9.
  static void write(std::ofstream& book, std::string_view number) { book << number << '\n' << std::flush; }
  void send() {
    if (std::filesystem::exists(pause_)) return;
    const std::string number = std::to_string(next_);
    if (context_->publish("data", drivers::Payload::copy(number)) != drivers::PublishStatus::accepted) return;
    write(sent_, number);
    ++next_;
  }

  drivers::DriverContext* context_ = nullptr;
  drivers::HandlerId timer_{};
  std::filesystem::path pause_;
  std::uint64_t next_ = 1;
  std::ofstream sent_, received_;
};

}  // namespace

// The topology of deploy/cluster reads the channels of drivers of this name.
IOTCLOUD_DRIVER(Ledger, "loadgen", "1.0")
