#include "iotcloud/tests/fuzz/mutations.h"

#include <algorithm>
#include <cstddef>
#include <random>

namespace iotcloud::fuzz {

namespace {

constexpr std::size_t most_bytes = 65'536;  // as ./dev fuzz has it

class Mutator {
 public:
  Mutator(const std::vector<std::string>& seeds, std::uint64_t number)
      : seeds_(seeds), random_(number), bytes_(any_seed()) {}

  std::string mutated() {
    for (std::uint64_t left = 1 + below(4); left > 0; --left) change();
    bytes_.resize(std::min(bytes_.size(), most_bytes));
    return bytes_;
  }

 private:
  struct Range {
    std::size_t at;
    std::size_t size;
  };

  std::uint64_t below(std::uint64_t limit) { return limit == 0 ? 0 : random_() % limit; }
  const std::string& any_seed() { return seeds_[below(seeds_.size())]; }
  void flip_bit(char& byte) { byte = static_cast<char>(byte ^ 1 << below(8)); }
  char any_byte() { return static_cast<char>(below(256)); }
  /// Returns a mostly short range, since lengths and names are short.
  Range any_range(const std::string& text) {
    const std::size_t at = below(text.size());
    const std::size_t most = text.size() - at;
    return {at, below(1 + (below(4) == 0 ? most : std::min<std::size_t>(most, 16)))};
  }

  void change() {
    switch (below(10)) {
      case 0:
        if (!bytes_.empty()) flip_bit(bytes_[below(bytes_.size())]);
        return;
      case 1:
        if (!bytes_.empty()) bytes_[below(bytes_.size())] = any_byte();
        return;
      case 2:
        bytes_.resize(below(bytes_.size() + 1));
        return;
      case 3: {
        std::string added(1 + below(16), '\0');
        std::generate(added.begin(), added.end(), [this] { return any_byte(); });
        bytes_.insert(below(bytes_.size() + 1), added);
        return;
      }
      case 4: {
        const Range range = any_range(bytes_);
        bytes_.erase(range.at, range.size);
        return;
      }
      case 5: {
        const Range range = any_range(bytes_);
        bytes_.insert(below(bytes_.size() + 1), bytes_.substr(range.at, range.size));
        return;
      }
      case 6: {  // copies a range over another place; the length stays
        const Range range = any_range(bytes_);
        const std::string moved = bytes_.substr(range.at, range.size);
        overwrite(below(bytes_.size() + 1), moved);
        return;
      }
      case 7: {  // the beginning of this input and the end of that one
        const std::string& other = any_seed();
        bytes_.resize(below(bytes_.size() + 1));
        bytes_ += other.substr(below(other.size() + 1));
        return;
      }
      default:
        overwrite(below(bytes_.size() + 1), any_number());
        return;
    }
  }

  /// A number near which byte-counting code goes wrong, in one of the usual notations.
  std::string any_number() {
    const std::size_t width = std::size_t{1} << below(4);
    std::uint64_t value = 0;
    switch (below(4)) {
      case 0:
        value = below(3);
        break;
      case 1:
        value = bytes_.size() + below(17);
        break;
      default:
        value = std::uint64_t{1} << below(8 * width);
        break;
    }
    value += below(3) - 1;  // may underflow
    std::string number;
    for (std::size_t i = 0; i < width; ++i) number.push_back(static_cast<char>(value >> (8 * i)));
    if (below(2) == 0) std::reverse(number.begin(), number.end());
    return number;
  }

  void overwrite(std::size_t at, const std::string& with) {
    const std::size_t size = std::min(with.size(), bytes_.size() - at);
    bytes_.replace(at, size, with, 0, size);
  }

  const std::vector<std::string>& seeds_;
  std::mt19937_64 random_;
  std::string bytes_;
};

}  // namespace

std::string mutation(const std::vector<std::string>& seeds, std::uint64_t number) {
  return Mutator(seeds, number).mutated();
}

}  // namespace iotcloud::fuzz
