#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>

#include <iotcloud/bench/harness/bodies.h>
#include <iotcloud/bench/paper/application/conductor.h>
#include <iotcloud/drivers/driver.h>

namespace iotcloud::bench::paper {

/// The paper's mock driver: sends what the conductor's orders demand on `data`, each message when it is due, and
/// receives the echoes on `echo`. Latency counts from the due time to on_message(). Properties: `folder` (of orders and
/// reports), `host` and `hosts` (the number of this process, and how many there are), `shared`, `broker`.
class LoadDriver : public drivers::Driver {
 public:
  static constexpr std::string_view data_channel = "data", echo_channel = "echo";

  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap& properties) override;
  void open(drivers::DriverContext& context) override;
  void activate() override;
  void deactivate() override;
  void close() override { deactivate(); }
  void on_message(std::string_view channel, drivers::Message message) override;
  void on_writable(std::string_view channel) override;

 private:
  /// The first bytes of each body.
  struct Stamp {
    std::uint64_t order;  ///< leftover messages of another order are not counted
    std::uint64_t number;
    std::int64_t intended_ns;
  };
  struct Options {
    std::string folder, broker;
    unsigned host = 0, hosts = 1;
    bool shared = false;
  };
  static Options read_options(const drivers::PropertyMap& properties);
  void begin(std::shared_ptr<Point> point);
  void send_due();
  void wait_for_next();

  drivers::DriverContext* context_ = nullptr;
  Options options_;
  std::shared_ptr<Conductor> conductor_;
  std::optional<unsigned> number_;  ///< its number in this process, while it takes part
  std::optional<drivers::HandlerId> timer_;
  std::shared_ptr<Point> point_;
  std::optional<Bodies> bodies_;
  unsigned turn_ = 0;
  std::uint64_t messages_ = 0;             ///< how many this order demands
  std::uint64_t next_ = 0, expected_ = 0;  ///< numbers of the next message to send, and of the next to come back
  bool blocked_ = false;
};

}  // namespace iotcloud::bench::paper
