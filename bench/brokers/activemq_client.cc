#include <atomic>
#include <cstdio>
#include <cstring>
#include <deque>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <proton/binary.hpp>
#include <proton/connection.hpp>
#include <proton/connection_options.hpp>
#include <proton/container.hpp>
#include <proton/delivery.hpp>
#include <proton/error_condition.hpp>
#include <proton/message.hpp>
#include <proton/messaging_handler.hpp>
#include <proton/receiver_options.hpp>
#include <proton/sender.hpp>
#include <proton/sender_options.hpp>
#include <proton/tracker.hpp>
#include <proton/transport.hpp>
#include <proton/work_queue.hpp>

#include <iotcloud/bench/brokers/client.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {

namespace {

constexpr int credit = 200;
constexpr std::size_t links_of_a_session = 500;  // with 2000 links in one session, some never opened
constexpr std::int64_t connect_limit_ns = 60'000'000'000;

/// One end of the bare client, on qpid-proton alone: one connection, all on one thread.
class End final : public proton::messaging_handler {
 public:
  using Take = std::function<void(unsigned index, const proton::message& message)>;

  /// \param from, to queues: what arrives from `from[i]` is handed to `take(i, ...)`; send(i, ...) sends to `to[i]`.
  End(const BrokerOptions& options, std::vector<std::string> from, std::vector<std::string> to)
      : options_(options), from_(std::move(from)), to_(std::move(to)), senders_(to_.size()) {}

  void start(Take take) {
    take_ = std::move(take);
    thread_ = std::jthread([this] { proton::container(*this).run(); });
    const std::int64_t limit = now_ns() + connect_limit_ns;
    while (open_ < from_.size() + to_.size()) {
      if (now_ns() > limit) fail("not all links were open within 60 s");
      sleep_until(now_ns() + 1'000'000);
    }
  }

  /// On the end's own thread.
  void send(unsigned index, const proton::message& message) { senders_[index].send(message); }

  /// On any thread.
  void call(std::function<void()> work) { connection_.work_queue().add(std::move(work)); }

  void stop() {
    call([this] { connection_.close(); });
    thread_ = {};
  }

 private:
  /// Reads from one receiver; accepts each message when it has been taken.
  class Reader final : public proton::messaging_handler {
   public:
    Reader(End& end, unsigned index) : end_(end), index_(index) {}

   private:
    void on_receiver_open(proton::receiver&) override { ++end_.open_; }
    void on_message(proton::delivery&, proton::message& message) override { end_.take_(index_, message); }
    void on_error(const proton::error_condition& error) override { fail(error.what()); }

    End& end_;
    const unsigned index_;
  };

  void on_container_start(proton::container& container) override {
    constexpr std::string_view scheme = "activemq://";
    if (!options_.url.starts_with(scheme)) fail("not a URL of ActiveMQ: " + options_.url);
    container.connect("amqp://" + options_.url.substr(scheme.size()));
  }

  void on_connection_open(proton::connection& connection) override {
    connection_ = connection;
    const auto settling =
        options_.confirms ? proton::delivery_mode::AT_LEAST_ONCE : proton::delivery_mode::AT_MOST_ONCE;
    proton::session session;
    std::size_t links = 0;
    const auto next_session = [&]() -> proton::session& {
      if (links++ % links_of_a_session == 0) session = connection.open_session();
      return session;
    };
    for (std::size_t index = 0; index < to_.size(); ++index) {
      senders_[index] = next_session().open_sender(to_[index], proton::sender_options().delivery_mode(settling));
    }
    for (unsigned index = 0; index < from_.size(); ++index) {
      Reader& reader = readers_.emplace_back(*this, index);
      next_session().open_receiver(
          from_[index], proton::receiver_options().credit_window(credit).delivery_mode(settling).handler(reader));
    }
  }

  void on_sender_open(proton::sender&) override { ++open_; }

  void on_tracker_reject(proton::tracker&) override { fail("a message was rejected"); }
  void on_error(const proton::error_condition& error) override { fail(error.what()); }
  void on_session_error(proton::session& session) override { fail(session.error().what()); }
  void on_transport_error(proton::transport& transport) override { fail(transport.error().what()); }

  [[noreturn]] static void fail(const std::string& problem) {
    std::fprintf(stderr, "bare client: %s\n", problem.c_str());
    std::_Exit(1);  // no more messages would come back
  }

  const BrokerOptions& options_;
  const std::vector<std::string> from_, to_;
  Take take_;
  proton::connection connection_;
  std::vector<proton::sender> senders_;
  std::deque<Reader> readers_;
  std::atomic<std::size_t> open_ = 0;
  std::jthread thread_;
};

class ActiveMqClient final : public Client {
 public:
  ActiveMqClient(const BrokerOptions& options, Load& load)
      : options_(options),
        load_(load),
        device_(options, queues("control"), queues("data")),
        cloud_(options, queues("data"), queues("control")) {}

  void connect() override {
    cloud_.start([this](unsigned index, const proton::message& message) {
      proton::message back;
      back.body() = message.body();
      back.properties() = message.properties();
      cloud_.send(index, back);
    });
    device_.start([this](unsigned, const proton::message& message) {
      const auto body = proton::get<proton::binary>(message.body());
      if (const auto next = load_.arrived(std::as_bytes(std::span(body)))) send(*next);
    });
  }

  void begin() override {
    schedule_ = std::jthread([this] {
      load_.send_on_schedule([this](unsigned driver) { device_.call([this, driver] { send(driver); }); });
    });
  }

  void stop() override {
    schedule_ = {};
    device_.stop();
    cloud_.stop();
  }

 private:
  std::vector<std::string> queues(const char* channel) const {
    std::vector<std::string> names;
    for (unsigned index = 0; index < (options_.shared ? 1 : options_.drivers); ++index) {
      names.push_back(options_.name + (options_.shared ? "." : "." + std::to_string(index) + ".") + channel);
    }
    return names;
  }

  /// On the device end's thread. The message has the same properties as this project's.
  void send(unsigned driver) {
    load_.send(driver, [&](const Stamp& stamp) {
      proton::binary body;
      body.resize(options_.size);
      std::memcpy(body.data(), &stamp, sizeof stamp);
      proton::message message;
      message.body(body);
      message.properties().put("sensorID", std::to_string(driver));
      message.properties().put("siteID", std::string("bench"));
      message.properties().put("time", std::string("1"));
      device_.send(options_.shared ? 0 : driver, message);
    });
  }

  const BrokerOptions& options_;
  Load& load_;
  End device_, cloud_;
  std::jthread schedule_;
};

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  using namespace iotcloud::bench;
  return measure_client("activemq", argc, argv, [](const BrokerOptions& options, Load& load) {
    return std::make_unique<ActiveMqClient>(options, load);
  });
}
