#include <iotcloud/bench/codec/contestant.h>
#include <iotcloud/drivers/depth/depth_codec.h>

namespace iotcloud::bench {

namespace {

using drivers::depth::no_reading;

/// Numbers in groups of four bits: three bits of the number, and one that says whether it continues; eight groups per
/// word.
class Nibbles {
 public:
  explicit Nibbles(Bytes& bytes) : bytes_(bytes) {}
  void put(std::uint32_t value) {
    do {
      const std::uint32_t group = (value & 7) | (value > 7 ? 8 : 0);
      value >>= 3;
      word_ = word_ << 4 | group;
      if (++groups_ == 8) spill();
    } while (value != 0);
  }
  void finish() {
    if (groups_ == 0) return;
    word_ <<= 4 * (8 - groups_);
    spill();
  }

 private:
  void spill() {
    for (const int shift : {0, 8, 16, 24}) bytes_.push_back(static_cast<std::byte>(word_ >> shift & 0xff));
    word_ = 0;
    groups_ = 0;
  }
  Bytes& bytes_;
  std::uint32_t word_ = 0;
  int groups_ = 0;
};

class NibbleReader {
 public:
  explicit NibbleReader(const Bytes& bytes) : next_(bytes.data()) {}
  std::uint32_t get() {
    std::uint32_t value = 0;
    for (int shift = 0;; shift += 3) {
      if (groups_ == 0) fill();
      const std::uint32_t group = word_ >> 28;
      word_ <<= 4;
      --groups_;
      value |= (group & 7) << shift;
      if (group < 8) return value;
    }
  }

 private:
  void fill() {
    word_ = 0;
    for (const int shift : {0, 8, 16, 24}) word_ |= std::to_integer<std::uint32_t>(*next_++) << shift;
    groups_ = 8;
  }
  const std::byte* next_;
  std::uint32_t word_ = 0;
  int groups_ = 0;
};

class Rvl : public Contestant {
 public:
  void encode(const Frame& disparities, Bytes& out) override {
    out.clear();
    Nibbles nibbles(out);
    std::int32_t before = 0;
    for (auto at = disparities.begin(); at != disparities.end();) {
      const auto gap = at;
      while (at != disparities.end() && *at == no_reading) ++at;
      nibbles.put(static_cast<std::uint32_t>(at - gap));
      const auto run = at;
      while (at != disparities.end() && *at != no_reading) ++at;
      nibbles.put(static_cast<std::uint32_t>(at - run));
      for (auto pixel = run; pixel != at; ++pixel) {
        const std::int32_t change = *pixel - before;
        nibbles.put(static_cast<std::uint32_t>(change << 1 ^ change >> 31));
        before = *pixel;
      }
    }
    nibbles.finish();
  }
  void decode(const Bytes& bytes, Frame& out) override {
    NibbleReader nibbles(bytes);
    std::int32_t before = 0;
    for (auto at = out.begin(); at != out.end();) {
      for (std::uint32_t gap = nibbles.get(); gap > 0; --gap) *at++ = no_reading;
      for (std::uint32_t run = nibbles.get(); run > 0; --run) {
        const std::uint32_t folded = nibbles.get();
        before += static_cast<std::int32_t>(folded >> 1) ^ -static_cast<std::int32_t>(folded & 1);
        *at++ = static_cast<std::uint16_t>(before);
      }
    }
  }
};

}  // namespace

std::unique_ptr<Contestant> make_rvl() {
  return std::make_unique<Rvl>();
}

}  // namespace iotcloud::bench
