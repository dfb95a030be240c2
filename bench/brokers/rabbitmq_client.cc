#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <amqp.h>
#include <amqp_tcp_socket.h>
#include <poll.h>
#include <sys/prctl.h>

#include <iotcloud/bench/brokers/client.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {

namespace {

constexpr amqp_channel_t reading = 1, writing = 2;
constexpr int frame_max = 131072;
constexpr std::uint16_t prefetch = 200;
constexpr std::uint64_t most_unacknowledged = 50;

amqp_bytes_t bytes_of(std::string_view text) {
  return {text.size(), const_cast<char*>(text.data())};
}

/// One end of the bare client, on librabbitmq alone: one connection of one thread, with a channel to read and one to
/// write.
class End {
 public:
  explicit End(const BrokerOptions& options) : options_(options), connection_(amqp_new_connection()) {
    amqp_connection_info server;
    std::string url = options.url;
    amqp_default_connection_info(&server);
    if (amqp_parse_url(url.data(), &server) != AMQP_STATUS_OK) throw std::runtime_error("cannot read " + options.url);
    amqp_socket_t* socket = amqp_tcp_socket_new(connection_);
    if (amqp_socket_open(socket, server.host, server.port) != AMQP_STATUS_OK) {
      throw std::runtime_error("cannot connect to " + options.url);
    }
    const char* virtual_host = *server.vhost != 0 ? server.vhost : "/";
    check(amqp_login(connection_, virtual_host, 0, frame_max, 0, AMQP_SASL_METHOD_PLAIN, server.user, server.password));
    for (const amqp_channel_t channel : {reading, writing}) {
      amqp_channel_open(connection_, channel);
      check(amqp_get_rpc_reply(connection_));
    }
    amqp_basic_qos(connection_, reading, 0, prefetch, 0);
    check(amqp_get_rpc_reply(connection_));
    amqp_exchange_declare(connection_, writing, bytes_of(options.name), bytes_of("direct"), 0, 0, 0, 0,
                          amqp_empty_table);
    check(amqp_get_rpc_reply(connection_));
    if (options.confirms) {
      amqp_confirm_select(connection_, writing);
      check(amqp_get_rpc_reply(connection_));
    }
  }
  End(const End&) = delete;
  End& operator=(const End&) = delete;
  ~End() {
    amqp_connection_close(connection_, AMQP_REPLY_SUCCESS);
    amqp_destroy_connection(connection_);
  }

  void read_from(const std::string& queue) {
    amqp_queue_declare(connection_, reading, bytes_of(queue), 0, 0, 0, 1, amqp_empty_table);
    check(amqp_get_rpc_reply(connection_));
    amqp_queue_bind(connection_, reading, bytes_of(queue), bytes_of(options_.name), bytes_of(queue), amqp_empty_table);
    check(amqp_get_rpc_reply(connection_));
    amqp_basic_consume(connection_, reading, bytes_of(queue), bytes_of(queue), 0, options_.acknowledgements ? 0 : 1, 1,
                       amqp_empty_table);
    check(amqp_get_rpc_reply(connection_));
  }

  /// With the same headers as this project's client.
  void publish(const std::string& queue, const std::string& driver, amqp_bytes_t body) {
    const auto header = [](const char* key, std::string_view value) {
      amqp_table_entry_t entry;
      entry.key = amqp_cstring_bytes(key);
      entry.value.kind = AMQP_FIELD_KIND_UTF8;
      entry.value.value.bytes = bytes_of(value);
      return entry;
    };
    std::array<amqp_table_entry_t, 3> headers{header("sensorID", driver), header("siteID", "bench"),
                                              header("time", "1")};
    amqp_basic_properties_t properties{};
    properties._flags = AMQP_BASIC_HEADERS_FLAG | AMQP_BASIC_DELIVERY_MODE_FLAG;
    properties.delivery_mode = 1;
    properties.headers = {static_cast<int>(headers.size()), headers.data()};
    const int status =
        amqp_basic_publish(connection_, writing, bytes_of(options_.name), bytes_of(queue), 0, 0, &properties, body);
    if (status != AMQP_STATUS_OK) throw std::runtime_error(amqp_error_string2(status));
  }

  /// Passes on all messages that have arrived, waiting for the first one until `until_ns`; then acknowledges.
  /// \param take (queue, message); the message lives only during the call.
  template <typename Take>
  void read(std::int64_t until_ns, Take&& take) {
    if (!amqp_frames_enqueued(connection_) && !amqp_data_in_buffer(connection_) && !wait(until_ns)) return;
    timeval at_once{0, 0};
    for (;;) {
      amqp_maybe_release_buffers_on_channel(connection_, reading);
      amqp_frame_t frame;
      const int status = amqp_simple_wait_frame_noblock(connection_, &frame, &at_once);
      if (status == AMQP_STATUS_TIMEOUT) break;
      if (status != AMQP_STATUS_OK) throw std::runtime_error(amqp_error_string2(status));
      if (frame.frame_type != AMQP_FRAME_METHOD || frame.payload.method.id != AMQP_BASIC_DELIVER_METHOD) continue;
      const auto& delivery = *static_cast<amqp_basic_deliver_t*>(frame.payload.method.decoded);
      const std::string queue(static_cast<const char*>(delivery.routing_key.bytes), delivery.routing_key.len);
      last_tag_ = delivery.delivery_tag;
      amqp_message_t message;
      check(amqp_read_message(connection_, reading, &message, 0));
      take(queue, message);
      amqp_destroy_message(&message);
      if (last_tag_ - acknowledged_ >= most_unacknowledged) acknowledge();
    }
    if (last_tag_ != acknowledged_) acknowledge();
  }

 private:
  static void check(const amqp_rpc_reply_t& reply) {
    if (reply.reply_type == AMQP_RESPONSE_NORMAL) return;
    throw std::runtime_error(reply.reply_type == AMQP_RESPONSE_LIBRARY_EXCEPTION
                                 ? amqp_error_string2(reply.library_error)
                                 : "the server refused a request");
  }

  bool wait(std::int64_t until_ns) {
    pollfd socket{amqp_get_sockfd(connection_), POLLIN, 0};
    const std::int64_t left = std::max<std::int64_t>(0, until_ns - now_ns());
    const timespec limit{static_cast<time_t>(left / 1'000'000'000), static_cast<long>(left % 1'000'000'000)};
    return ::ppoll(&socket, 1, &limit, nullptr) > 0;
  }

  void acknowledge() {
    acknowledged_ = last_tag_;
    if (options_.acknowledgements) amqp_basic_ack(connection_, reading, last_tag_, 1);
  }

  const BrokerOptions& options_;
  const amqp_connection_state_t connection_;
  std::uint64_t last_tag_ = 0, acknowledged_ = 0;
};

class RabbitMqClient final : public Client {
 public:
  RabbitMqClient(const BrokerOptions& options, Load& load)
      : options_(options), load_(load), device_(options), body_(options.size, 'x') {
    if (!options.devices_only) cloud_.emplace(options);
    for (unsigned driver = 0; driver < options.drivers; ++driver) names_.push_back(std::to_string(driver));
  }

  void connect() override {
    for (unsigned index = 0; index < (options_.shared ? 1 : options_.drivers); ++index) {
      device_.read_from(queue(index, "control"));
      if (cloud_) cloud_->read_from(queue(index, "data"));
    }
    if (cloud_) echo_ = std::jthread([this](const std::stop_token& stop) { guard([&] { echo(stop); }); });
  }

  void begin() override {
    device_thread_ = std::jthread([this](const std::stop_token& stop) { guard([&] { send_and_receive(stop); }); });
  }

  void stop() override {
    device_thread_ = {};
    echo_ = {};
  }

 private:
  static constexpr std::int64_t look_for_stop_ns = 100'000'000;

  std::string queue(unsigned index, const char* channel) const {
    return options_.name + (options_.shared ? "." : "." + names_[index] + ".") + channel;
  }

  template <typename Work>
  static void guard(Work&& work) {
    prctl(PR_SET_TIMERSLACK, 1UL);
    try {
      work();
    } catch (const std::exception& error) {
      std::fprintf(stderr, "bare client: %s\n", error.what());
      std::_Exit(1);  // no more messages would come back
    }
  }

  void echo(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      cloud_->read(now_ns() + look_for_stop_ns, [&](const std::string& from, const amqp_message_t& message) {
        const std::string to = from.substr(0, from.size() - std::strlen("data")) + "control";
        cloud_->publish(to, driver_of(message), message.body);
      });
    }
  }

  static std::string driver_of(const amqp_message_t& message) {
    const amqp_bytes_t id = message.properties.headers.entries[0].value.value.bytes;
    return {static_cast<const char*>(id.bytes), id.len};
  }

  void send_and_receive(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      while (load_.due_ns() <= now_ns()) send(load_.take_due());
      device_.read(std::min(load_.due_ns(), now_ns() + look_for_stop_ns),
                   [&](const std::string&, const amqp_message_t& message) {
                     const auto* body = static_cast<const std::byte*>(message.body.bytes);
                     if (const auto next = load_.arrived({body, message.body.len})) send(*next);
                   });
    }
  }

  void send(unsigned driver) {
    load_.send(driver, [&](const Stamp& stamp) {
      std::memcpy(body_.data(), &stamp, sizeof stamp);
      device_.publish(queue(options_.shared ? 0 : driver, "data"), names_[driver], bytes_of(body_));
    });
  }

  const BrokerOptions& options_;
  Load& load_;
  std::vector<std::string> names_;
  End device_;
  std::optional<End> cloud_;
  std::string body_;
  std::jthread echo_, device_thread_;
};

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  using namespace iotcloud::bench;
  return measure_client("rabbitmq", argc, argv, [](const BrokerOptions& options, Load& load) {
    return std::make_unique<RabbitMqClient>(options, load);
  });
}
