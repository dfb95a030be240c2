#include <algorithm>

#include <iotcloud/bench/codec/contestant.h>
#include <iotcloud/drivers/depth/depth_codec.h>

namespace iotcloud::bench {

namespace {

using drivers::depth::no_reading;

class BitSink {
 public:
  explicit BitSink(Bytes& bytes) : bytes_(bytes) {}
  void put(std::uint32_t value, int bits) {
    pending_ = pending_ << bits | value;
    for (held_ += bits; held_ >= 8; held_ -= 8)
      bytes_.push_back(static_cast<std::byte>(pending_ >> (held_ - 8) & 0xff));
  }
  void put_ones_and_zero(std::uint32_t ones) {
    for (; ones >= 16; ones -= 16) put(0xffff, 16);
    put((1U << ones << 1) - 2, static_cast<int>(ones) + 1);
  }
  void finish() {
    if (held_ > 0) put(0, 8 - held_);
  }

 private:
  Bytes& bytes_;
  std::uint64_t pending_ = 0;
  int held_ = 0;
};

class BitSource {
 public:
  explicit BitSource(const Bytes& bytes) : next_(bytes.data()), end_(next_ + bytes.size()) {}
  std::uint32_t get(int bits) {
    while (held_ < bits) {
      pending_ = pending_ << 8 | (next_ < end_ ? std::to_integer<std::uint64_t>(*next_++) : 0);
      held_ += 8;
    }
    held_ -= bits;
    return static_cast<std::uint32_t>(pending_ >> held_ & ((1ULL << bits) - 1));
  }
  std::uint32_t get_ones() {
    std::uint32_t ones = 0;
    while (get(1) != 0) ++ones;
    return ones;
  }

 private:
  const std::byte* next_;
  const std::byte* end_;
  std::uint64_t pending_ = 0;
  int held_ = 0;
};

/// Estimates of the lengths of zero runs and of other numbers: both in eighths of a bit, adapted on the way.
struct Adaptation {
  int run = 8, size = 8;
  int run_bits() const { return run >> 3; }
  int size_bits() const { return size >> 3; }
  void change_run(int by) { run = std::clamp(run + by, 0, 80); }
  void saw_quotient(std::uint32_t ones) {
    if (ones == 0) size = std::max(size - 2, 0);
    if (ones > 1) size = std::min(size + static_cast<int>(ones), 80);
  }
};
constexpr int full_run = 4, broken_run = -6, zero = 3, no_zero = -3;

class RunLengthGolombRice {
 public:
  explicit RunLengthGolombRice(BitSink& sink) : sink_(sink) {}
  void put(std::uint32_t value) {
    if (adaptation_.run_bits() > 0) {
      if (value == 0) {
        if (++zeros_ < 1U << adaptation_.run_bits()) return;
        sink_.put(0, 1);
        zeros_ = 0;
        adaptation_.change_run(full_run);
        return;
      }
      sink_.put(1, 1);
      sink_.put(zeros_, adaptation_.run_bits());
      zeros_ = 0;
      put_golomb_rice(value - 1);
      adaptation_.change_run(broken_run);
      return;
    }
    put_golomb_rice(value);
    adaptation_.change_run(value == 0 ? zero : no_zero);
  }
  void finish() {
    if (zeros_ > 0) sink_.put(0, 1);  // the rest of a full run is never asked for
    sink_.finish();
  }

 private:
  void put_golomb_rice(std::uint32_t value) {
    const int bits = adaptation_.size_bits();
    const std::uint32_t ones = value >> bits;
    sink_.put_ones_and_zero(ones);
    sink_.put(value & ((1U << bits) - 1), bits);
    adaptation_.saw_quotient(ones);
  }
  BitSink& sink_;
  Adaptation adaptation_;
  std::uint32_t zeros_ = 0;
};

class RunLengthGolombRiceReader {
 public:
  explicit RunLengthGolombRiceReader(BitSource& source) : source_(source) {}
  std::uint32_t get() {
    if (zeros_ > 0) {
      --zeros_;
      return 0;
    }
    if (ends_run_) {
      ends_run_ = false;
      const std::uint32_t value = get_golomb_rice() + 1;
      adaptation_.change_run(broken_run);
      return value;
    }
    if (adaptation_.run_bits() == 0) {
      const std::uint32_t value = get_golomb_rice();
      adaptation_.change_run(value == 0 ? zero : no_zero);
      return value;
    }
    if (source_.get(1) == 0) {
      zeros_ = 1U << adaptation_.run_bits();
      adaptation_.change_run(full_run);
    } else {
      zeros_ = source_.get(adaptation_.run_bits());
      ends_run_ = true;
    }
    return get();
  }

 private:
  std::uint32_t get_golomb_rice() {
    const int bits = adaptation_.size_bits();
    const std::uint32_t ones = source_.get_ones();
    const std::uint32_t value = ones << bits | source_.get(bits);
    adaptation_.saw_quotient(ones);
    return value;
  }
  BitSource& source_;
  Adaptation adaptation_;
  std::uint32_t zeros_ = 0;
  bool ends_run_ = false;
};

/// The folded difference of each pixel to the last reading. A smaller number marks where readings begin or end.
constexpr std::uint32_t edge = 8;
std::uint32_t number_of(std::int32_t change) {
  const auto folded = static_cast<std::uint32_t>(change << 1 ^ change >> 31);
  return folded < edge ? folded : folded + 1;
}
std::int32_t change_of(std::uint32_t number) {
  const std::uint32_t folded = number < edge ? number : number - 1;
  return static_cast<std::int32_t>(folded >> 1) ^ -static_cast<std::int32_t>(folded & 1);
}

class Mehrotra : public Contestant {
 public:
  void encode(const Frame& disparities, Bytes& out) override {
    out.clear();
    BitSink sink(out);
    RunLengthGolombRice coder(sink);
    std::int32_t before = 0;
    bool reading = true;
    for (const std::uint16_t pixel : disparities) {
      if ((pixel != no_reading) != reading) {
        reading = !reading;
        coder.put(edge);
      }
      const std::int32_t change = reading ? pixel - before : 0;
      coder.put(number_of(change));
      before += change;
    }
    coder.finish();
  }
  void decode(const Bytes& bytes, Frame& out) override {
    BitSource source(bytes);
    RunLengthGolombRiceReader coder(source);
    std::int32_t before = 0;
    bool reading = true;
    for (std::uint16_t& pixel : out) {
      std::uint32_t number = coder.get();
      if (number == edge) {
        reading = !reading;
        number = coder.get();
      }
      before += change_of(number);
      pixel = reading ? static_cast<std::uint16_t>(before) : no_reading;
    }
  }
};

}  // namespace

std::unique_ptr<Contestant> make_mehrotra() {
  return std::make_unique<Mehrotra>();
}

}  // namespace iotcloud::bench
