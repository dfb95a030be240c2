#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/http/http_end.h>
#include <iotcloud/drivers/stream/common_properties.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::http {

/// Devices and services that speak HTTP: README.md.
class HttpDriver : public Driver {
 public:
  static constexpr std::string_view received_channel = "received", call_channel = "call", answers_channel = "answers";
  static constexpr std::string_view description =
      "HTTP: webhooks that come in on received; calls of messages on call, and their answers on answers";
  static constexpr std::array declared_properties{
      PropertySpec{.name = "listen", .text = "ADDRESS:PORT at which webhooks come; port 0: any"},
      PropertySpec{.name = "path", .default_value = "/", .text = "listen: the beginning of the paths that are taken"},
      PropertySpec{.name = "certificate",
                   .text = "listen: file of the server's certificate; without it there is no TLS"},
      PropertySpec{.name = "key", .text = "listen: file of its key"},
      PropertySpec{.name = "token_file", .text = "listen: file whose first line senders show; beyond loopback needed"},
      PropertySpec{.name = "plain",
                   .type = PropertyType::flag,
                   .default_value = "false",
                   .text = "listen: beyond loopback without TLS, so that the token can be read on the way"},
      PropertySpec{.name = "connections",
                   .type = PropertyType::integer,
                   .min = 1,
                   .max = 10'000,
                   .default_value = "64",
                   .text = "listen: most at a time"},
      PropertySpec{.name = "call_url",
                   .text = "http://HOST[:80]/PATH or https://HOST[:443]/PATH that messages on call go to"},
      PropertySpec{.name = "call_method",
                   .default_value = "POST",
                   .choices = {"GET", "POST", "PUT", "PATCH", "DELETE"},
                   .text = "of messages without the property method"},
      PropertySpec{.name = "call_content_type",
                   .default_value = "application/json",
                   .text = "of messages without the property content_type"},
      PropertySpec{.name = "call_token_file", .text = "file whose first line is shown as the bearer's token; none"},
      PropertySpec{.name = "ca", .text = "https: file of the authority; the system's"},
      PropertySpec{.name = "call_timeout_ms",
                   .type = PropertyType::integer,
                   .unit = "ms",
                   .min = 10,
                   .max = 600'000,
                   .default_value = "10000",
                   .text = "longest time for each step of a call"},
      PropertySpec{.name = "calls_waiting",
                   .type = PropertyType::integer,
                   .min = 1,
                   .max = 1'000'000,
                   .default_value = "100",
                   .text = "most that wait for the call before them; those beyond are lost"},
      stream::most_bytes_property("of a request that comes, and of an answer"),
      stream::broker_property,
  };

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }
  void close() override;
  void on_message(std::string_view channel, Message message) override;

 private:
  struct Options {
    ServerOptions server;
    bool serves = false;
    std::string path, token_file, call_token_file, broker;
    Call call;  ///< with the properties' values
    bool calls = false;
    std::size_t calls_waiting = 100;
  };
  static Options read_options(const PropertyMap& properties);
  /// On HttpEnd's thread.
  WebhookAnswer take(const Webhook& webhook);
  bool shows_token(const Webhook& webhook) const;
  std::string queue(const Message& message);
  void call_next();
  void answered(const CallAnswer& answer);

  DriverContext* context_ = nullptr;
  Options options_;
  std::string token_, call_token_;
  std::optional<stream::DeviceState> state_;
  std::optional<stream::RareLog> lost_;
  std::atomic<bool> active_{false};
  std::deque<std::pair<Call, std::int64_t>> waiting_;  ///< with the times of their messages; the first one is under way
  std::unique_ptr<HttpEnd> end_;                       ///< ends first
};

}  // namespace iotcloud::drivers::http
