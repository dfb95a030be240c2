#include <cmath>
#include <fstream>
#include <stdexcept>

#include <iotcloud/bench/paper/application/order.h>

namespace iotcloud::bench::paper {

std::int64_t Order::intended_ns(unsigned turn, std::uint64_t number) const {
  const double periods = static_cast<double>(number) + static_cast<double>(turn) / drivers;
  return start_ns + std::llround(1e9 / rate * periods);
}

std::uint64_t Order::messages(unsigned turn) const {
  auto count = static_cast<std::uint64_t>(std::max(0.0, static_cast<double>(until_ns - start_ns) / 1e9 * rate)) + 1;
  while (count > 0 && intended_ns(turn, count - 1) >= until_ns) --count;
  return count;
}

std::optional<Order> read_order(const std::string& file) {
  std::ifstream stream(file);
  if (!stream) return std::nullopt;
  Order order;
  stream >> order.id >> order.size >> order.rate >> order.drivers >> order.start_ns >> order.from_ns >>
      order.until_ns >> order.patience_ns;
  if (!stream || order.id == 0 || order.rate <= 0 || order.drivers == 0) {
    throw std::runtime_error(file + ": not an order: \"ID SIZE RATE DRIVERS START_NS FROM_NS UNTIL_NS PATIENCE_NS\"");
  }
  return order;
}

}  // namespace iotcloud::bench::paper
