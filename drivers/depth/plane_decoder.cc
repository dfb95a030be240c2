#include <algorithm>
#include <cstring>

#include <iotcloud/drivers/depth/plane_codec.h>

namespace iotcloud::drivers::depth::groups {

namespace {

constexpr int nothing_table = tables;

/// Most bytes that decoding a row reads past the end; decode() checks the place after each row.
template <typename Plane>
constexpr std::size_t margin = most_row_steps<Plane> * 2;

}  // namespace

template <typename Plane>
PlaneDecoder<Plane>::PlaneDecoder()
    : tables_(std::make_unique_for_overwrite<entropy::DecodingTable[]>(tables + 1)),
      stream_(std::make_unique_for_overwrite<std::byte[]>(most_stream_bytes<Plane> + margin<Plane>)) {
  entropy::Frequencies nothing{};
  nothing[none_symbol] = entropy::scale;
  entropy::fill(tables_[nothing_table], nothing, Rises<Plane>::shared().left);
}

template <typename Plane>
bool PlaneDecoder<Plane>::decode(std::span<const std::byte> bytes, Value* plane) {
  entropy::BitReader reader(bytes);
  if (!read_tables(reader)) return false;
  if (!begin_stream(bytes.subspan(reader.bytes_read()))) return false;
  rows_.begin();
  for (std::size_t v = 0; v < frame_height; ++v) {
    Value* row = plane + v * frame_width;
    rows_.classify();
    decode_row(row, v == 0 ? no_row<Plane>.data() : row - frame_width);
    if (next_ > stream_end_) return false;
    rows_.next_row();
  }
  const auto is_at_its_end = [](std::uint32_t state) { return state == entropy::lowest_state; };
  return next_ == stream_end_ && std::all_of(states_.begin(), states_.end(), is_at_its_end);
}

template <typename Plane>
bool PlaneDecoder<Plane>::read_tables(entropy::BitReader& reader) {
  std::array<bool, tables> own{};
  for (bool& is_own : own) is_own = reader.get(1) != 0;
  for (int table = 0; table < tables; ++table) {
    if (!own[table]) continue;
    entropy::Frequencies frequencies;
    if (!entropy::read_table(reader, frequencies, symbols_of(table))) return false;
    entropy::fill(tables_[table], frequencies, Rises<Plane>::shared().left);
  }
  for (int table = 0; table < tables; ++table) {
    const int others = table < contexts && own[shared_table] ? shared_table : nothing_table;
    table_of_[table] = &tables_[own[table] ? table : others];
  }
  return !reader.overrun();
}

template <typename Plane>
bool PlaneDecoder<Plane>::begin_stream(std::span<const std::byte> stream) {
  constexpr std::size_t states_bytes = sizeof states_;
  if (stream.size() < states_bytes || stream.size() > most_stream_bytes<Plane>) return false;
  std::memcpy(states_.data(), stream.data(), states_bytes);
  const std::span<const std::byte> symbols = stream.subspan(states_bytes);
  std::copy(symbols.begin(), symbols.end(), stream_.get());
  next_ = stream_.get();
  stream_end_ = next_ + symbols.size();
  std::fill_n(stream_.get() + symbols.size(), margin<Plane>, std::byte{0});
  return std::all_of(states_.begin(), states_.end(), [](std::uint32_t s) { return s >= entropy::lowest_state; });
}

template <typename Plane>
IOTCLOUD_PIXEL_LOOP void PlaneDecoder<Plane>::decode_row(Value* row, const Value* row_above) {
  constexpr std::uint32_t none_group = Plane::low_bits * Plane::none;
  const Rises<Plane>& rises = Rises<Plane>::shared();
  const Value* above = rows_.above();
  Value* filled = rows_.current();
  std::uint8_t* kinds = rows_.kinds();
  const std::uint8_t* classes = rows_.classes();
  std::array<std::uint32_t, lanes> states = states_;
  const std::byte* next = next_;
  std::array<std::uint32_t, lanes> left;
  left.fill(left_unknown);
  for (std::uint32_t step = 0; step < Rows<Plane>::lane_groups; ++step) {
#pragma GCC unroll 4
    for (std::uint32_t lane = 0; lane < lanes; ++lane) {
      const std::uint32_t group = lane * Rows<Plane>::lane_groups + step;
      const std::size_t at = group * std::size_t{Plane::pixels};
      const std::uint32_t up = load(above + at);
      const std::uint32_t context = classes[group] * std::uint32_t{left_classes} + left[lane];
      const auto [symbol, mark] = entropy::get_symbol(states[lane], *table_of_[context], next);
      left[lane] = mark;
      if (symbol < none_symbol) {
        const std::uint32_t now = add<Plane>(up, rises.group[symbol]);
        store(row + at, now);
        store(filled + at, now);
        kinds[group] = read;
        continue;
      }
      if (symbol == none_symbol) {
        store(row + at, none_group);
        store(filled + at, up);
        kinds[group] = none;
      } else {
        const Place place = decode_other({states[lane], next}, row, row_above, at, step == 0);
        states[lane] = place.state;
        next = place.next;
        kinds[group] = other;
      }
    }
  }
  states_ = states;
  next_ = next;
}

template <typename Plane>
typename PlaneDecoder<Plane>::Place PlaneDecoder<Plane>::decode_other(Place place, Value* row, const Value* row_above,
                                                                      std::size_t at, bool lane_begins) {
  const Value* above = rows_.above();
  Value* filled = rows_.current();
  for (std::size_t i = at; i < at + Plane::pixels; ++i) {
    const bool first = lane_begins && i == at;
    const bool left_read = (first ? row_above[i] : row[i - 1]) != Plane::none;
    const int beside = first ? above[i] : filled[i - 1];
    const std::uint32_t table = pixel_table<Plane>(row_above, i, left_read);
    const std::uint32_t symbol = entropy::get_symbol(place.state, *table_of_[table], place.next).value;
    if (symbol == pixel_none) {
      row[i] = Plane::none;
      filled[i] = above[i];
      continue;
    }
    const int value = symbol == pixel_literal
                          ? static_cast<int>(entropy::get_bits(place.state, Plane::value_bits, place.next))
                          : beside + static_cast<int>(symbol) - pixel_zero;
    row[i] = filled[i] = static_cast<Value>(value);
  }
  return place;
}

template class PlaneDecoder<CodePlane>;
template class PlaneDecoder<DisparityPlane>;

}  // namespace iotcloud::drivers::depth::groups
