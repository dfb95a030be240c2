// Tables and symbols of the better codecs, apart from what they stand for.
#include <algorithm>
#include <array>
#include <numeric>
#include <random>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/depth/entropy.h>

namespace iotcloud::drivers::depth::entropy {
namespace {

constexpr int symbols = 40;

std::uint32_t sum_of(const Frequencies& frequencies) {
  return std::accumulate(frequencies.begin(), frequencies.end(), 0U);
}

Frequencies table_of(std::initializer_list<std::uint16_t> first) {
  Frequencies frequencies{};
  std::copy(first.begin(), first.end(), frequencies.begin());
  return frequencies;
}

bool is_read_back(const Frequencies& frequencies) {
  std::vector<std::byte> bytes;
  BitWriter writer(bytes);
  write_table(writer, frequencies, symbols);
  writer.finish();
  BitReader reader(bytes);
  Frequencies back;
  return read_table(reader, back, symbols) && back == frequencies;
}

TEST(DepthEntropy, scales_counts_to_a_full_table_in_which_what_occurs_stays) {
  std::mt19937 random(1);
  for (int round = 0; round < 200; ++round) {
    std::array<std::uint32_t, symbols> counts{};
    for (auto& count : counts) {
      const auto most = std::uint32_t{1} << (random() % 18);
      count = random() % 3 == 0 ? 0 : static_cast<std::uint32_t>(1 + random() % most);
    }
    counts[random() % symbols] += 1;
    const Frequencies frequencies = normalise(counts);
    EXPECT_EQ(sum_of(frequencies), scale);
    for (int i = 0; i < symbols; ++i) EXPECT_EQ(frequencies[i] > 0, counts[i] > 0);
    EXPECT_TRUE(is_read_back(frequencies));
  }
}

TEST(DepthEntropy, reads_full_tables_only) {
  EXPECT_TRUE(is_read_back(table_of({1000, 24})));
  EXPECT_TRUE(is_read_back(table_of({0, 0, 1024})));
  EXPECT_FALSE(is_read_back(table_of({1000, 23})));
  EXPECT_FALSE(is_read_back(table_of({1000, 25})));
  EXPECT_FALSE(is_read_back(table_of({})));
  Frequencies last{};
  last[symbols - 1] = scale;
  EXPECT_TRUE(is_read_back(last));
}

TEST(DepthEntropy, refuses_a_table_that_is_cut_off_or_has_symbols_that_there_are_not) {
  std::vector<std::byte> bytes;
  BitWriter writer(bytes);
  write_table(writer, table_of({7, 0, 0, 1017}), symbols);
  writer.finish();
  Frequencies back;
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    BitReader cut({bytes.data(), size});
    EXPECT_FALSE(read_table(cut, back, symbols)) << size << " of " << bytes.size() << " bytes";
  }
  BitReader fewer(bytes);
  EXPECT_FALSE(read_table(fewer, back, 3));
  const std::vector<std::byte> zeros(64);
  BitReader endless(zeros);
  EXPECT_FALSE(read_table(endless, back, symbols));
}

TEST(DepthEntropy, carries_symbols_marks_and_bits_in_several_states) {
  const Frequencies frequencies = normalise(std::array<std::uint32_t, 4>{900, 90, 9, 1});
  std::array<Share, 4> shares;
  std::uint16_t first = 0;
  for (int i = 0; i < 4; ++i) {
    shares[i] = {first, frequencies[i]};
    first = static_cast<std::uint16_t>(first + frequencies[i]);
  }
  std::mt19937 random(2);
  std::vector<std::uint32_t> sent(5000);
  for (auto& value : sent) value = random() % 100 < 90 ? 0 : static_cast<std::uint32_t>(random() % 4);

  std::vector<std::byte> stream(sent.size() * 4 + 8);
  std::byte* end = stream.data() + stream.size() - 2;  // a step looks at the next 16 bits, whether it takes them or not
  BackwardWriter writer(end);
  std::array<std::uint32_t, 2> states{lowest_state, lowest_state};
  for (std::size_t i = sent.size(); i-- > 0;) {
    writer.put_bits(states[i % 2], sent[i] * 500, 11);
    writer.put(states[i % 2], shares[sent[i]]);
  }

  DecodingTable table;
  std::array<std::uint8_t, most_symbols> marks{5, 0, 3, 15};
  fill(table, frequencies, marks);
  const std::byte* next = writer.position();
  for (std::size_t i = 0; i < sent.size(); ++i) {
    const Symbol symbol = get_symbol(states[i % 2], table, next);
    ASSERT_EQ(symbol.value, sent[i]) << i;
    ASSERT_EQ(symbol.mark, marks[sent[i]]) << i;
    ASSERT_EQ(get_bits(states[i % 2], 11, next), sent[i] * 500) << i;
  }
  EXPECT_EQ(next, end);
  EXPECT_THAT(states, testing::Each(lowest_state));
}

}  // namespace
}  // namespace iotcloud::drivers::depth::entropy
