#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <utility>

#include <unistd.h>

#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/bench/paper/application/conductor.h>

namespace iotcloud::bench::paper {

namespace {

constexpr std::int64_t millisecond_ns = 1'000'000;
constexpr std::int64_t look_every_ns = 50 * millisecond_ns;

std::mutex all_mutex;
std::map<std::string, std::weak_ptr<Conductor>>& all() {
  static std::map<std::string, std::weak_ptr<Conductor>> conductors;
  return conductors;
}

}  // namespace

std::shared_ptr<Conductor> Conductor::of(const std::string& folder) {
  const std::lock_guard lock(all_mutex);
  std::weak_ptr<Conductor>& known = all()[folder];
  std::shared_ptr<Conductor> conductor = known.lock();
  if (!conductor) known = conductor = std::make_shared<Conductor>(folder);
  return conductor;
}

Conductor::Conductor(std::string folder)
    : folder_(std::move(folder)), thread_([this](const std::stop_token& stop) { run(stop); }) {}

Conductor::~Conductor() = default;

unsigned Conductor::join(Begin begin) {
  const std::lock_guard lock(mutex_);
  drivers_.emplace(joined_, std::move(begin));
  return joined_++;
}

void Conductor::leave(unsigned number) {
  const std::lock_guard lock(mutex_);
  drivers_.erase(number);
}

void Conductor::run(const std::stop_token& stop) {
  std::uint64_t last = 0;
  while (wait_until(now_ns() + look_every_ns, stop)) {
    try {
      const std::optional<Order> order = read_order(folder_ + "/order");
      if (!order || order->id == last) continue;
      last = order->id;
      carry_out(*order, stop);
    } catch (const std::exception& error) {
      std::fprintf(stderr, "paper drivers: %s\n", error.what());
    }
  }
}

void Conductor::carry_out(const Order& order, const std::stop_token& stop) {
  const auto point = std::make_shared<Point>(order);
  std::size_t drivers = 0;
  {
    const std::lock_guard lock(mutex_);
    drivers = drivers_.size();
    for (const auto& [number, begin] : drivers_) begin(point);
  }
  if (!wait_until(order.until_ns, stop)) return;
  while (!point->complete(drivers) && now_ns() < order.until_ns + order.patience_ns) {
    if (!wait_until(now_ns() + millisecond_ns, stop)) return;
  }
  write(*point);
}

bool Conductor::wait_until(std::int64_t when_ns, const std::stop_token& stop) {
  for (std::int64_t now = now_ns(); now < when_ns && !stop.stop_requested(); now = now_ns()) {
    sleep_until(std::min(when_ns, now + look_every_ns));
  }
  return !stop.stop_requested();
}

void Conductor::write(const Point& point) const {
  const std::string file = folder_ + "/" + std::to_string(::getpid()) + ".json";
  const std::string part = file + ".part";
  std::ofstream stream(part);
  stream << point.report() << '\n';
  stream.close();
  if (!stream) throw std::runtime_error("cannot write " + part);
  std::filesystem::rename(part, file);  // so that a reader finds the complete file
}

}  // namespace iotcloud::bench::paper
