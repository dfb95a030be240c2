#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <random>
#include <stdexcept>

#include <nlohmann/json.hpp>

#include <iotcloud/drivers/loadgen/load_generator.h>
#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::drivers::loadgen {

namespace {

constexpr std::uint32_t magic = 0x4c47494f;  // "OIGL"
constexpr double most_ticks = 1000;          // ticks a second; faster rates send bursts

nlohmann::ordered_json in_us(const Latencies& latencies) {
  return {{"mean", latencies.mean_us()},
          {"p50", latencies.quantile_us(0.5)},
          {"p99", latencies.quantile_us(0.99)},
          {"p999", latencies.quantile_us(0.999)},
          {"max", latencies.quantile_us(1)}};
}

}  // namespace

LoadGenerator::Options LoadGenerator::read_options(const PropertyMap& properties) {
  Options options;
  PropertyReader reader(properties);
  options.size = static_cast<std::size_t>(reader.integer("size", 1024, least_size, 64 << 20));
  options.rate = reader.number("rate", options.rate, 0.01, 1e6);
  options.count = static_cast<std::uint64_t>(reader.integer("count", 0, 0, INT64_MAX));
  options.warm_up = static_cast<std::uint64_t>(reader.integer("warm_up", 0, 0, INT64_MAX));
  options.shared = reader.flag("shared", options.shared);
  options.broker = reader.text("broker", options.broker);
  options.report = reader.text("report", options.report);
  reader.finish();
  return options;
}

std::vector<ChannelSpec> LoadGenerator::channels(const PropertyMap& properties) {
  const Options options = read_options(properties);
  ChannelSpec data;
  data.name = data_channel;
  data.direction = Direction::out;
  data.broker = options.broker;
  data.shared = options.shared;
  ChannelSpec echo = data;
  echo.name = echo_channel;
  echo.direction = Direction::in;
  return {data, echo};
}

void LoadGenerator::open(DriverContext& context) {
  context_ = &context;
  options_ = read_options(context.properties());
  trips_ = RoundTrips(options_.warm_up);
  if (!options_.report.empty() && !std::ofstream(options_.report, std::ios::app)) {
    throw std::runtime_error("property \"report\": cannot write \"" + options_.report +
                             "\"; name a file in a folder that exists and may be written");
  }
  const double ticks = std::min(options_.rate, most_ticks);
  tick_ = std::chrono::microseconds(std::llround(1e6 / ticks));
  per_tick_ = options_.rate / ticks;
  opened_ = clock_();
  std::random_device entropy;
  run_ = (std::uint64_t{entropy()} << 32) | entropy();
  filler_.resize(options_.size);
  std::mt19937 bytes(1);
  for (std::byte& byte : filler_) byte = static_cast<std::byte>(bytes() & 0xff);
}

void LoadGenerator::activate() {
  first_of_run_ = trips_.sent_count();
  blocked_ = false;
  // Set before the timer starts: the first tick is never earlier than the messages that it sends.
  activated_ = running();
  timer_ = context_->every(tick_, [this] { send_due(); });
}

void LoadGenerator::deactivate() {
  if (timer_) context_->stop(*timer_);
  timer_.reset();
}

void LoadGenerator::close() {
  deactivate();
  if (context_) report();
}

std::uint64_t LoadGenerator::due() const {
  const auto ticks = static_cast<std::uint64_t>((running() - activated_) / tick_);
  const auto since_activation = static_cast<std::uint64_t>(static_cast<double>(ticks) * per_tick_);
  const std::uint64_t number = first_of_run_ + since_activation;
  return options_.count == 0 ? number : std::min(number, options_.count);
}

std::chrono::nanoseconds LoadGenerator::intended(std::uint64_t message) const {
  // The first tick by which more than `message` messages are due.
  const double tick = std::floor(static_cast<double>(message - first_of_run_) / per_tick_) + 1;
  return activated_ + static_cast<std::int64_t>(tick) * std::chrono::nanoseconds(tick_);
}

Message LoadGenerator::make(std::uint64_t sequence) {
  Head head{magic, static_cast<std::uint32_t>(options_.size), run_, sequence, intended(sequence).count()};
  std::vector<std::byte> bytes(filler_);
  std::memcpy(bytes.data(), &head, sizeof head);
  Message message;
  message.payload = Payload::take(std::move(bytes));
  return message;
}

void LoadGenerator::send_due() {
  if (blocked_ || !timer_) return;
  for (const std::uint64_t end = due(); trips_.sent_count() < end;) {
    const PublishStatus status = context_->publish(data_channel, make(trips_.sent_count()));
    if (status == PublishStatus::would_block) {
      blocked_ = true;
      ++times_blocked_;
      return;
    }
    if (status == PublishStatus::closed) return;
    trips_.sent();
  }
  if (options_.count != 0 && trips_.sent_count() == options_.count) deactivate();
}

void LoadGenerator::on_writable(std::string_view channel) {
  if (channel != data_channel) return;
  blocked_ = false;
  send_due();
}

void LoadGenerator::on_message(std::string_view channel, Message message) {
  const auto arrived = running();
  if (channel != echo_channel) return;
  const auto bytes = message.payload.bytes();
  Head head;
  if (bytes.size() >= sizeof head) std::memcpy(&head, bytes.data(), sizeof head);
  if (head.magic == magic && head.run != run_) {
    ++foreign_;
    return;
  }
  const bool whole = head.magic == magic && head.size == bytes.size() && bytes.size() == options_.size &&
                     std::equal(bytes.begin() + sizeof head, bytes.end(), filler_.begin() + sizeof head);
  if (!whole || !trips_.received(head.sequence, arrived - std::chrono::nanoseconds(head.intended_ns))) {
    ++damaged_;
    return;
  }
  if (options_.count != 0 && trips_.received_count() == options_.count) report();
}

void LoadGenerator::report() {
  const nlohmann::ordered_json json{{"instance", context_->instance_id()},
                                    {"size", options_.size},
                                    {"rate", options_.rate},
                                    {"count", options_.count},
                                    {"shared", options_.shared},
                                    {"sent", trips_.sent_count()},
                                    {"received", trips_.received_count()},
                                    {"lost", trips_.lost()},
                                    {"duplicated", trips_.duplicated()},
                                    {"out_of_order", trips_.out_of_order()},
                                    {"furthest_back", trips_.furthest_back()},
                                    {"damaged", damaged_},
                                    {"foreign", foreign_},
                                    {"times_blocked", times_blocked_},
                                    {"latency_us", in_us(trips_.latencies())},
                                    {"warm_up", options_.warm_up},
                                    {"warm_up_latency_us", in_us(trips_.latencies_of_warm_up())}};
  context_->log(LogLevel::info, "round trips: " + json.dump());
  if (options_.report.empty()) return;
  // Whoever reads it sees a whole report, this one or the one before.
  const std::string unfinished = options_.report + ".unfinished";
  std::ofstream file(unfinished, std::ios::trunc);
  file << json.dump(2) << '\n';
  file.close();
  if (!file || std::rename(unfinished.c_str(), options_.report.c_str()) != 0)
    context_->log(LogLevel::error, "cannot write the report \"" + options_.report + "\"");
}

}  // namespace iotcloud::drivers::loadgen
