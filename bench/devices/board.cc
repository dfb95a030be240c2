#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <string>
#include <system_error>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/bench/devices/board.h>
#include <iotcloud/bench/harness/machine.h>

namespace iotcloud::bench {

static_assert(std::atomic<std::int64_t>::is_always_lock_free, "two processes share them");

namespace {

/// An open file.
class Descriptor {
 public:
  Descriptor(const std::filesystem::path& file, int flags) : value_(::open(file.c_str(), flags | O_CLOEXEC, 0600)) {
    if (value_ < 0) throw std::system_error(errno, std::generic_category(), file);
  }
  ~Descriptor() { ::close(value_); }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int value() const { return value_; }

 private:
  const int value_;
};

}  // namespace

bool Reading::parse(std::string_view bytes, Reading& reading) {
  if (bytes.size() < sizeof reading) return false;
  std::memcpy(&reading, bytes.data(), sizeof reading);
  return true;
}

std::filesystem::path Board::file(const std::filesystem::path& folder, std::int64_t run) {
  return folder / ("board-" + std::to_string(run));
}

Board::Board(const std::filesystem::path& file, std::uint64_t most) {
  const Descriptor descriptor(file, O_RDWR | O_CREAT | O_TRUNC);
  const auto bytes = static_cast<::off_t>(sizeof(Head) + most * sizeof(std::int64_t));
  if (::ftruncate(descriptor.value(), bytes) != 0) throw std::system_error(errno, std::generic_category(), file);
  map(descriptor.value());
}

Board::Board(const std::filesystem::path& file) {
  map(Descriptor(file, O_RDWR).value());
}

void Board::map(int descriptor) {
  struct ::stat status = {};
  if (::fstat(descriptor, &status) != 0) throw std::system_error(errno, std::generic_category(), "a board's size");
  const auto bytes = static_cast<std::size_t>(status.st_size);
  void* const memory = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, descriptor, 0);
  if (memory == MAP_FAILED) throw std::system_error(errno, std::generic_category(), "mapping a board");
  head_ = static_cast<Head*>(memory);  // the kernel's zeros are its initial state
  latencies_ = reinterpret_cast<std::atomic<std::int64_t>*>(head_ + 1);
  most_ = (bytes - sizeof(Head)) / sizeof(std::int64_t);
}

Board::~Board() {
  ::munmap(head_, sizeof(Head) + most_ * sizeof(std::int64_t));
}

void Board::take(const Reading& reading) {
  if (reading.number >= most_) return;
  std::int64_t none = 0;
  const std::int64_t latency = std::max<std::int64_t>(now_ns() - reading.due_ns, 1);
  if (latencies_[reading.number].compare_exchange_strong(none, latency)) {
    ++head_->count;
  } else {
    ++head_->again;
  }
}

LatencyHistogram::Summary Board::summary(std::uint64_t first) const {
  const auto histogram = std::make_unique<LatencyHistogram>();
  for (std::uint64_t number = first; number < most_; ++number) {
    if (const std::int64_t latency = latencies_[number]; latency != 0) histogram->record_ns(latency);
  }
  return histogram->summary();
}

}  // namespace iotcloud::bench
