#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/loadgen/round_trips.h>

namespace iotcloud::drivers::loadgen {

/// Sends messages of a given size at a given rate on `data`, and measures when they come back on `echo`. Latency counts
/// from the time when a message was due, so that delays of the sender show. README.md has the properties, the payload
/// and the report.
class LoadGenerator : public Driver {
 public:
  static constexpr std::string_view data_channel = "data";
  static constexpr std::string_view echo_channel = "echo";
  static constexpr std::string_view description =
      "Sends messages of a given size at a given rate on data, and measures when they come back on echo";
  static constexpr std::size_t least_size = 32;  ///< what the head of a payload takes
  static constexpr std::array declared_properties{
      PropertySpec{.name = "size",
                   .type = PropertyType::integer,
                   .unit = "bytes",
                   .min = least_size,
                   .max = 64 << 20,
                   .default_value = "1024",
                   .text = "of each payload"},
      PropertySpec{.name = "rate",
                   .type = PropertyType::number,
                   .unit = "1/s",
                   .min = 0.01,
                   .max = 1e6,
                   .default_value = "10",
                   .text = "messages a second; above 1000 a burst each millisecond"},
      PropertySpec{.name = "count",
                   .type = PropertyType::integer,
                   .min = 0,
                   .default_value = "0",
                   .text = "how many messages; 0: no limit"},
      PropertySpec{.name = "warm_up",
                   .type = PropertyType::integer,
                   .min = 0,
                   .default_value = "0",
                   .text = "the latencies of so many messages at the beginning are reported apart"},
      PropertySpec{.name = "shared",
                   .type = PropertyType::flag,
                   .default_value = "false",
                   .text = "all instances on the gateway share both channels"},
      PropertySpec{.name = "broker", .text = "logical broker of both channels; the gateway's first"},
      PropertySpec{.name = "report", .text = "JSON file, written when all of count are back, and at close; none"},
  };
  using Clock = std::function<std::chrono::steady_clock::time_point()>;

  explicit LoadGenerator(Clock clock = &std::chrono::steady_clock::now) : clock_(std::move(clock)) {}

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override;
  void deactivate() override;
  void close() override;
  void on_message(std::string_view channel, Message message) override;
  void on_writable(std::string_view channel) override;

 private:
  struct Options {
    std::size_t size = 1024;
    double rate = 10;
    std::uint64_t count = 0, warm_up = 0;
    bool shared = false;
    std::string broker, report;
  };
  /// The beginning of a payload, in the machine's own byte order: only its sender reads it.
  struct Head {
    std::uint32_t magic = 0, size = 0;
    std::uint64_t run = 0, sequence = 0;
    std::int64_t intended_ns = 0;  ///< when the message was due, since open()
  };
  static_assert(sizeof(Head) == least_size);

  static Options read_options(const PropertyMap& properties);
  void send_due();
  std::uint64_t due() const;
  std::chrono::nanoseconds intended(std::uint64_t message) const;
  std::chrono::nanoseconds running() const { return clock_() - opened_; }
  Message make(std::uint64_t sequence);
  void report();

  const Clock clock_;
  DriverContext* context_ = nullptr;
  Options options_;
  std::chrono::microseconds tick_{0};
  double per_tick_ = 1;            ///< messages that become due with each tick
  std::vector<std::byte> filler_;  ///< bytes that do not compress, a message's worth
  std::uint64_t run_ = 0;          ///< tells this instance's messages from others' on a shared channel
  std::chrono::steady_clock::time_point opened_{};
  std::chrono::nanoseconds activated_{0};  ///< the last activation, since open()
  std::optional<HandlerId> timer_;
  std::uint64_t first_of_run_ = 0;  ///< number of the first message since that activation
  bool blocked_ = false;
  RoundTrips trips_;
  std::uint64_t times_blocked_ = 0, foreign_ = 0, damaged_ = 0;
};

}  // namespace iotcloud::drivers::loadgen
