#include <cstring>

#include <unistd.h>

#include <iotcloud/bench/brokers/load.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {

Load::Load(const BrokerOptions& options)
    : run_(static_cast<std::uint32_t>(::getpid())),
      size_(options.size),
      driver_count_(options.drivers),
      step_ns_(options.rate > 0 ? 1e9 / options.rate / options.drivers : 0),
      loop_(options.under_way),
      drivers_(std::make_unique<Driver[]>(options.drivers)) {}

void Load::begin() {
  began_ns_ = now_ns();
}

std::int64_t Load::due_ns() const {
  if (stopped_) return never;
  if (step_ns_ == 0) return taken_ < loop_ ? 0 : never;
  return began_ns_ + static_cast<std::int64_t>(static_cast<double>(taken_) * step_ns_);
}

unsigned Load::take_due() {
  return static_cast<unsigned>(taken_++ % driver_count_);
}

std::int64_t Load::intended_ns(unsigned driver, std::uint64_t number) const {
  if (step_ns_ == 0) return now_ns();
  return began_ns_ + static_cast<std::int64_t>(static_cast<double>(number * driver_count_ + driver) * step_ns_);
}

std::optional<unsigned> Load::arrived(std::span<const std::byte> body) {
  Stamp stamp;
  if (body.size() < sizeof stamp) return std::nullopt;
  std::memcpy(&stamp, body.data(), sizeof stamp);
  if (stamp.run != run_ || stamp.driver >= driver_count_) return std::nullopt;
  if (body.size() != size_ || drivers_[stamp.driver].expected.exchange(stamp.number + 1) != stamp.number) ++wrong_;
  arrived_.fetch_add(1, std::memory_order_relaxed);
  if (stamp.intended_ns >= record_from_ns_ && stamp.intended_ns < record_until_ns_) {
    latency_.record_ns(now_ns() - stamp.intended_ns);
  }
  if (step_ns_ > 0 || stopped_) return std::nullopt;
  return stamp.driver;
}

void Load::begin_recording() {
  record_from_ns_ = now_ns();
}

void Load::end_recording() {
  record_until_ns_ = now_ns();
}

}  // namespace iotcloud::bench
