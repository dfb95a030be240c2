// Plays many devices at an MQTT broker: announces them as Home Assistant's discovery wants, and sends readings of all
// of them at a steady rate. A bare subscriber of the devices' topics hears them in this process, and the topology's
// bolt (readings_bolt.cc) on the other board. bench/devices_report.py runs it.
#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <mosquitto.h>
#include <poll.h>
#include <sys/prctl.h>

#include <iotcloud/bench/devices/board.h>
#include <iotcloud/bench/harness/latency_histogram.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {
namespace {

constexpr std::int64_t ns_per_s = 1'000'000'000;

void require(int status, const char* what) {
  if (status != MOSQ_ERR_SUCCESS) throw std::runtime_error(std::string(what) + ": " + mosquitto_strerror(status));
}

struct Free {
  void operator()(mosquitto* client) const { mosquitto_destroy(client); }
};
using Client = std::unique_ptr<mosquitto, Free>;

Client make_client(void* of) {
  Client client(mosquitto_new(nullptr, true, of));
  if (!client) throw std::runtime_error("no client of the library");
  mosquitto_int_option(client.get(), MOSQ_OPT_TCP_NODELAY, 1);
  mosquitto_max_inflight_messages_set(client.get(), 0);
  return client;
}

/// A subscriber with nothing around the library, on a thread of the library.
class BareSubscriber {
 public:
  BareSubscriber(int port, const char* filter, Board& board)
      : filter_(filter), board_(board), client_(make_client(this)) {
    mosquitto_connect_callback_set(client_.get(), [](mosquitto* client, void* self, int code) {
      if (code == 0) mosquitto_subscribe(client, nullptr, static_cast<BareSubscriber*>(self)->filter_, 1);
    });
    mosquitto_subscribe_callback_set(client_.get(), [](mosquitto*, void* self, int, int, const int*) {
      static_cast<BareSubscriber*>(self)->ready_ = true;
    });
    mosquitto_message_callback_set(client_.get(), [](mosquitto*, void* self, const mosquitto_message* message) {
      auto& own = *static_cast<BareSubscriber*>(self);
      Reading reading;
      if (Reading::parse({static_cast<const char*>(message->payload), static_cast<std::size_t>(message->payloadlen)},
                         reading))
        own.board_.take(reading);
    });
    require(mosquitto_connect(client_.get(), "127.0.0.1", port, 60), "the subscriber cannot connect");
    mosquitto_loop_start(client_.get());
    while (!ready_) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  ~BareSubscriber() {
    mosquitto_disconnect(client_.get());
    mosquitto_loop_stop(client_.get(), false);
  }
  BareSubscriber(const BareSubscriber&) = delete;
  BareSubscriber& operator=(const BareSubscriber&) = delete;

 private:
  const char* const filter_;
  Board& board_;
  std::atomic<bool> ready_{false};
  const Client client_;
};

/// The devices' connection, run by the calling thread: what is published goes into the socket at once, and no other
/// thread has to wake up for it.
class Sender {
 public:
  explicit Sender(int port) : client_(make_client(this)) {
    prctl(PR_SET_TIMERSLACK, 1UL);
    mosquitto_connect_callback_set(client_.get(), [](mosquitto*, void* self, int code) {
      if (code == 0) static_cast<Sender*>(self)->ready_ = true;
    });
    mosquitto_publish_callback_set(client_.get(), [](mosquitto*, void* self, int number) {
      auto& own = *static_cast<Sender*>(self);
      ++own.confirmed_;
      if (const std::int64_t due = own.due_[static_cast<std::uint16_t>(number)]; due != 0)
        own.taken_.record_ns(now_ns() - due);
    });
    require(mosquitto_connect(client_.get(), "127.0.0.1", port, 60), "the sender cannot connect");
    while (!ready_) run_until(now_ns() + ns_per_s);
  }

  /// \param due_ns when it was to be sent; 0: late() and taken() leave it out
  void publish(const std::string& topic, const void* bytes, std::size_t size, bool retain, std::int64_t due_ns) {
    if (published_ - confirmed_ == most_unconfirmed) {
      throw std::runtime_error("the MQTT broker does not keep up: " + std::to_string(most_unconfirmed) +
                               " messages are not confirmed");
    }
    if (due_ns != 0) late_.record_ns(now_ns() - due_ns);
    int number = 0;
    require(mosquitto_publish(client_.get(), &number, topic.c_str(), static_cast<int>(size), bytes, 1, retain),
            "a message cannot be published");
    due_[static_cast<std::uint16_t>(number)] = due_ns;
    ++published_;
  }

  /// Serves the connection until a time, at least once.
  void run_until(std::int64_t end_ns) {
    do {
      const std::int64_t left = std::max<std::int64_t>(end_ns - now_ns(), 0);
      const timespec limit{left / ns_per_s, left % ns_per_s};
      const short events = mosquitto_want_write(client_.get()) ? POLLIN | POLLOUT : POLLIN;
      pollfd socket{mosquitto_socket(client_.get()), events, 0};
      if (::ppoll(&socket, 1, &limit, nullptr) < 0 && errno != EINTR) throw std::runtime_error("ppoll failed");
      if ((socket.revents & POLLOUT) != 0) require(mosquitto_loop_write(client_.get(), 1), "the sender's connection");
      if ((socket.revents & ~POLLOUT) != 0) require(mosquitto_loop_read(client_.get(), 1), "the sender's connection");
      require(mosquitto_loop_misc(client_.get()), "the sender's connection");
    } while (now_ns() < end_ns);
  }
  /// Waits until the broker has confirmed all.
  void flush() {
    while (confirmed_ < published_) run_until(now_ns() + ns_per_s / 1000);
  }
  /// From when a message was due until it was handed to the library.
  LatencyHistogram::Summary late() const { return late_.summary(); }
  /// From when a message was due until the broker had confirmed it.
  LatencyHistogram::Summary taken() const { return taken_.summary(); }

 private:
  static constexpr std::uint64_t most_unconfirmed = 60'000;  ///< MQTT has 65 535 numbers

  bool ready_ = false;
  std::uint64_t published_ = 0, confirmed_ = 0;
  std::array<std::int64_t, 65'536> due_{};  ///< by number
  LatencyHistogram late_, taken_;
  const Client client_;
};

std::string device_name(std::uint64_t number) {
  return "d" + std::to_string(number);
}

/// Announces so many devices, or takes the announcements back.
void announce(Sender& sender, std::uint64_t devices, bool there) {
  for (std::uint64_t i = 0; i < devices; ++i) {
    const std::string name = device_name(i);
    const std::string text = R"({"~":"bench/)" + name + R"(","stat_t":"~/reading","dev":{"ids":[")" + name +
                             R"("],"mf":"bench","mdl":"reading"}})";
    sender.publish("homeassistant/sensor/" + name + "/reading/config", text.data(), there ? text.size() : 0, true, 0);
  }
  sender.flush();
}

void print(const char* what, const LatencyHistogram::Summary& of) {
  std::printf(R"(,"%s":{"timed":%llu,"p50_us":%.1f,"p99_us":%.1f,"max_us":%.1f})", what,
              static_cast<unsigned long long>(of.count), of.p50_us, of.p99_us, of.max_us);
}

void print(const char* what, const Board& board, std::uint64_t counts_from) {
  std::printf(R"(,"%s_heard":%llu,"%s_again":%llu)", what, static_cast<unsigned long long>(board.count()), what,
              static_cast<unsigned long long>(board.again()));
  print(what, board.summary(counts_from));
}

struct Load {
  int port = 0;
  std::filesystem::path boards;
  std::uint64_t devices = 0, rate = 0, size = 0;
  double warm_up_s = 0, seconds = 0, patience_s = 30;
};

/// Sends readings of all devices in turn, each when it is due, and waits until all that was sent has been heard, or
/// nothing more comes.
void carry(const Load& load) {
  const auto readings_in = [&](double seconds) {
    return static_cast<std::uint64_t>(static_cast<double>(load.rate) * seconds);
  };
  const std::uint64_t counts_from = readings_in(load.warm_up_s);
  const std::uint64_t total = counts_from + readings_in(load.seconds);
  const std::int64_t run = now_ns(), step = ns_per_s / static_cast<std::int64_t>(load.rate);
  Board bare(load.boards / ("bare-" + std::to_string(run)), total), through(Board::file(load.boards, run), total);
  const BareSubscriber subscriber(load.port, "bench/+/reading", bare);
  const auto sender = std::make_unique<Sender>(load.port);
  std::vector<std::string> topics;
  for (std::uint64_t i = 0; i < load.devices; ++i) topics.push_back("bench/" + device_name(i) + "/reading");
  std::string body(std::max(load.size, static_cast<std::uint64_t>(sizeof(Reading))), 'x');
  const std::int64_t began = now_ns() + step;
  constexpr std::uint64_t look_after = 16;  // how many late readings are sent before the broker's answers are read
  for (std::uint64_t i = 0; i < total; ++i) {
    const Reading reading{run, began + static_cast<std::int64_t>(i) * step, i};
    if (now_ns() < reading.due_ns || i % look_after == 0) sender->run_until(reading.due_ns);
    std::memcpy(body.data(), &reading, sizeof reading);
    sender->publish(topics[i % load.devices], body.data(), body.size(), false, i < counts_from ? 0 : reading.due_ns);
  }
  const double sending_s = static_cast<double>(now_ns() - began) / ns_per_s;
  sender->flush();
  std::uint64_t last = 0;
  std::int64_t moved = now_ns();
  while ((bare.count() < total || through.count() < total) &&
         now_ns() - moved < static_cast<std::int64_t>(load.patience_s * ns_per_s)) {
    sender->run_until(now_ns() + ns_per_s / 100);
    if (const std::uint64_t now = bare.count() + through.count(); now != last) {
      last = now;
      moved = now_ns();
    }
  }
  std::printf(R"({"sent":%llu,"seconds":%.3f)", static_cast<unsigned long long>(total), sending_s);
  print("late", sender->late());
  print("taken", sender->taken());
  print("bare", bare, counts_from);
  print("through", through, counts_from);
  std::printf("}\n");
}

int run(const std::vector<std::string>& words) {
  const bool loads = !words.empty() && words[0] == "load";
  if (words.size() != (loads ? 8 : 3)) {
    std::cerr << "usage: bench_devices announce|withdraw PORT DEVICES\n       bench_devices load PORT DEVICES RATE "
                 "SIZE WARM-UP-S SECONDS BOARDS\n";
    return EXIT_FAILURE;
  }
  Load load;
  load.port = std::stoi(words[1]);
  load.devices = std::stoull(words[2]);
  mosquitto_lib_init();
  if (loads) {
    load.rate = std::stoull(words[3]);
    load.size = std::stoull(words[4]);
    load.warm_up_s = std::stod(words[5]);
    load.seconds = std::stod(words[6]);
    load.boards = words[7];
    carry(load);
  } else {
    announce(*std::make_unique<Sender>(load.port), load.devices, words[0] == "announce");
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
