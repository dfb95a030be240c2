// Plays many devices at an MQTT broker: announces them as Home Assistant's discovery wants, sends readings of all of
// them at a steady rate, and hears each twice: as a bare subscriber of the devices' topics, and as what comes back
// through the system. bench/devices_report.py runs it.
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <mosquitto.h>

#include <iotcloud/bench/harness/latency_histogram.h>

namespace iotcloud::bench {
namespace {

using Steady = std::chrono::steady_clock;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Steady::now().time_since_epoch()).count();
}

/// The head of a reading; its topic says of which device it is.
struct Reading {
  std::int64_t due_ns = 0;  ///< when it was to be sent
  std::uint64_t number = 0;
};

/// What one subscriber has heard of the readings: each once, or not.
class Heard {
 public:
  explicit Heard(std::uint64_t most) : seen_(std::make_unique<std::atomic<bool>[]>(most)), most_(most) {}
  void take(const mosquitto_message& message, std::uint64_t counts_from) {
    Reading reading;
    if (static_cast<std::size_t>(message.payloadlen) < sizeof reading) return;
    std::memcpy(&reading, message.payload, sizeof reading);
    if (reading.number >= most_ || seen_[reading.number].exchange(true)) return;
    ++count_;
    if (reading.number >= counts_from) latency_.record_ns(now_ns() - reading.due_ns);
  }
  std::uint64_t count() const { return count_; }
  LatencyHistogram::Summary summary() const { return latency_.summary(); }

 private:
  const std::unique_ptr<std::atomic<bool>[]> seen_;
  const std::uint64_t most_;
  std::atomic<std::uint64_t> count_{0};
  LatencyHistogram latency_;
};

/// A connection to the broker on a thread of the library.
class Connection {
 public:
  Connection(int port, const std::string& filter, Heard* heard, std::uint64_t counts_from)
      : filter_(filter), heard_(heard), counts_from_(counts_from), client_(mosquitto_new(nullptr, true, this)) {
    mosquitto_int_option(client_, MOSQ_OPT_TCP_NODELAY, 1);
    mosquitto_max_inflight_messages_set(client_, 0);
    mosquitto_connect_callback_set(client_, [](mosquitto* client, void* self, int code) {
      auto& own = *static_cast<Connection*>(self);
      if (code != 0) return;
      if (own.filter_.empty()) {
        own.ready_ = true;
      } else {
        mosquitto_subscribe(client, nullptr, own.filter_.c_str(), 1);
      }
    });
    mosquitto_subscribe_callback_set(
        client_, [](mosquitto*, void* self, int, int, const int*) { static_cast<Connection*>(self)->ready_ = true; });
    mosquitto_publish_callback_set(client_,
                                   [](mosquitto*, void* self, int) { ++static_cast<Connection*>(self)->sent_; });
    mosquitto_message_callback_set(client_, [](mosquitto*, void* self, const mosquitto_message* message) {
      auto& own = *static_cast<Connection*>(self);
      if (own.heard_ != nullptr) own.heard_->take(*message, own.counts_from_);
    });
    if (mosquitto_connect(client_, "127.0.0.1", port, 60) != MOSQ_ERR_SUCCESS) {
      std::fprintf(stderr, "the broker at 127.0.0.1:%d cannot be reached\n", port);
      std::exit(EXIT_FAILURE);
    }
    mosquitto_loop_start(client_);
    while (!ready_) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  ~Connection() {
    mosquitto_disconnect(client_);
    mosquitto_loop_stop(client_, false);
    mosquitto_destroy(client_);
  }
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  void publish(const std::string& topic, const void* bytes, std::size_t size, bool retain) {
    if (mosquitto_publish(client_, nullptr, topic.c_str(), static_cast<int>(size), bytes, 1, retain) !=
        MOSQ_ERR_SUCCESS) {
      std::fprintf(stderr, "a message cannot be published\n");
      std::exit(EXIT_FAILURE);
    }
    ++published_;
  }
  /// Waits until the broker has confirmed all.
  void flush() {
    while (sent_ < published_) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }

 private:
  const std::string filter_;
  Heard* const heard_;
  const std::uint64_t counts_from_;
  mosquitto* const client_;
  std::atomic<bool> ready_{false};
  std::atomic<std::uint64_t> sent_{0};
  std::uint64_t published_ = 0;
};

std::string device_name(std::uint64_t number) {
  return "d" + std::to_string(number);
}

/// Announces so many devices, or takes the announcements back.
void announce(Connection& hub, std::uint64_t devices, bool there) {
  for (std::uint64_t i = 0; i < devices; ++i) {
    const std::string name = device_name(i);
    const std::string text = R"({"~":"bench/)" + name + R"(","stat_t":"~/reading","cmd_t":"~/echo","dev":{"ids":[")" +
                             name + R"("],"mf":"bench","mdl":"reading"}})";
    hub.publish("homeassistant/sensor/" + name + "/reading/config", text.data(), there ? text.size() : 0, true);
  }
  hub.flush();
}

void print(const char* what, const Heard& heard) {
  const auto of = heard.summary();
  std::printf(R"(,"%s":{"count":%llu,"timed":%llu,"p50_us":%.1f,"p99_us":%.1f,"max_us":%.1f})", what,
              static_cast<unsigned long long>(heard.count()), static_cast<unsigned long long>(of.count), of.p50_us,
              of.p99_us, of.max_us);
}

struct Options {
  int port = 0;
  std::uint64_t devices = 1000, rate = 5000, size = 100;
  double warm_up_s = 2, seconds = 10, patience_s = 60;
};

/// Sends readings of all devices in turn, each when it is due, and waits until all that was sent has been heard, or
/// nothing more comes.
void load(const Options& options) {
  const auto total =
      static_cast<std::uint64_t>(static_cast<double>(options.rate) * (options.warm_up_s + options.seconds));
  const auto counts_from = static_cast<std::uint64_t>(static_cast<double>(options.rate) * options.warm_up_s);
  Heard bare(total), through(total);
  const Connection subscriber(options.port, "bench/+/reading", &bare, counts_from);
  const Connection back(options.port, "bench/+/echo", &through, counts_from);
  Connection hub(options.port, "", nullptr, 0);
  std::vector<std::string> topics;
  for (std::uint64_t i = 0; i < options.devices; ++i) topics.push_back("bench/" + device_name(i) + "/reading");
  std::string body(std::max(options.size, static_cast<std::uint64_t>(sizeof(Reading))), 'x');
  const std::int64_t began = now_ns(), step = 1'000'000'000 / static_cast<std::int64_t>(options.rate);
  for (std::uint64_t i = 0; i < total; ++i) {
    const Reading reading{began + static_cast<std::int64_t>(i) * step, i};
    if (const std::int64_t left = reading.due_ns - now_ns(); left > 0)
      std::this_thread::sleep_for(std::chrono::nanoseconds(left));
    std::memcpy(body.data(), &reading, sizeof reading);
    hub.publish(topics[i % options.devices], body.data(), body.size(), false);
  }
  const double sending_s = static_cast<double>(now_ns() - began) / 1e9;
  std::uint64_t last = 0;
  auto moved = Steady::now();
  while ((bare.count() < total || through.count() < total) &&
         Steady::now() - moved < std::chrono::duration<double>(options.patience_s)) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    if (const std::uint64_t now = bare.count() + through.count(); now != last) {
      last = now;
      moved = Steady::now();
    }
  }
  std::printf(R"({"sent":%llu,"seconds":%.3f)", static_cast<unsigned long long>(total), sending_s);
  print("bare", bare);
  print("through", through);
  std::printf("}\n");
}

int run(const std::vector<std::string>& words) {
  Options options;
  const auto number = [&](std::size_t at) { return std::stod(words.at(at)); };
  if (words.size() < 3) {
    std::cerr << "usage: bench_devices announce|withdraw PORT DEVICES\n       bench_devices load PORT DEVICES RATE "
                 "SIZE WARM-UP-S SECONDS\n";
    return EXIT_FAILURE;
  }
  options.port = static_cast<int>(number(1));
  options.devices = static_cast<std::uint64_t>(number(2));
  mosquitto_lib_init();
  if (words[0] == "load") {
    options.rate = static_cast<std::uint64_t>(number(3));
    options.size = static_cast<std::uint64_t>(number(4));
    options.warm_up_s = number(5);
    options.seconds = number(6);
    load(options);
  } else {
    Connection hub(options.port, "", nullptr, 0);
    announce(hub, options.devices, words[0] == "announce");
  }
  mosquitto_lib_cleanup();
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  try {
    return iotcloud::bench::run({argv + 1, argv + argc});
  } catch (const std::exception& e) {
    std::cerr << e.what() << '\n';
    return EXIT_FAILURE;
  }
}
