#include <algorithm>
#include <cstring>
#include <numeric>

#include <iotcloud/drivers/depth/plane_codec.h>

namespace iotcloud::drivers::depth::groups {

namespace {

// A step packs a symbol or a literal (bits 0 to 15), its table (bits 16 to 24) and its lane.
constexpr int table_shift = 16, lane_shift = 28;
constexpr std::uint32_t literal_flag = 1U << 31;

/// A context that occurs this often gets a table of its own, which takes some 15 bytes.
constexpr std::uint32_t worth_a_table = 100;

template <typename Plane>
bool all_within_reach(std::uint32_t rises) {
  constexpr std::uint32_t high = Plane::high_bits;
  return (rises & high) == 0 && (((Plane::in_reach | high) - rises) & high) == high;
}

}  // namespace

template <typename Plane>
PlaneEncoder<Plane>::PlaneEncoder()
    : steps_(std::make_unique_for_overwrite<std::uint32_t[]>(most_row_steps<Plane> * frame_height)),
      stream_(std::make_unique_for_overwrite<std::byte[]>(most_stream_bytes<Plane>)) {}

template <typename Plane>
void PlaneEncoder<Plane>::encode(const Value* plane, std::vector<std::byte>& out) {
  model(plane);
  write_tables(out);
  write_symbols(out);
}

template <typename Plane>
void PlaneEncoder<Plane>::note(std::uint32_t lane, std::uint32_t table, std::uint32_t symbol) {
  *steps_end_++ = lane << lane_shift | table << table_shift | symbol;
  ++counts_[table][symbol];
}

template <typename Plane>
void PlaneEncoder<Plane>::model(const Value* plane) {
  rows_.begin();
  steps_end_ = steps_.get();
  for (auto& counts : counts_) counts.fill(0);
  for (std::size_t v = 0; v < frame_height; ++v) {
    const Value* row = plane + v * frame_width;
    rows_.classify();
    model_row(row, v == 0 ? no_row<Plane>.data() : row - frame_width);
    rows_.next_row();
  }
}

template <typename Plane>
IOTCLOUD_PIXEL_LOOP void PlaneEncoder<Plane>::model_row(const Value* row, const Value* row_above) {
  constexpr std::uint32_t none_group = Plane::low_bits * Plane::none;
  constexpr std::uint32_t reach_group = Plane::low_bits * Plane::reach;
  const Rises<Plane>& rises = Rises<Plane>::shared();
  const Value* above = rows_.above();
  Value* filled = rows_.current();
  std::uint8_t* kinds = rows_.kinds();
  std::array<std::uint8_t, lanes> left;
  left.fill(left_unknown);
  for (std::uint32_t step = 0; step < Rows<Plane>::lane_groups; ++step) {
    for (std::uint32_t lane = 0; lane < lanes; ++lane) {
      const std::uint32_t group = lane * Rows<Plane>::lane_groups + step;
      const std::size_t at = group * std::size_t{Plane::pixels};
      const std::uint32_t now = load(row + at), up = load(above + at);
      const std::uint32_t context = rows_.classes()[group] * std::uint32_t{left_classes} + left[lane];
      const std::uint32_t rise = add<Plane>(subtract<Plane>(now, up), reach_group);
      if (!has_zero<Plane>(now ^ none_group) && all_within_reach<Plane>(rise)) {
        const std::uint32_t symbol = rise * Plane::weights >> Plane::weight_shift;
        note(lane, context, symbol);
        store(filled + at, now);
        kinds[group] = read;
        left[lane] = rises.left[symbol];
      } else if (now == none_group) {
        note(lane, context, none_symbol);
        store(filled + at, up);
        kinds[group] = none;
        left[lane] = left_unknown;
      } else {
        note(lane, context, other_symbol);
        model_other(row, row_above, at, lane, step == 0);
        kinds[group] = other;
        left[lane] = left_unknown;
      }
    }
  }
}

template <typename Plane>
void PlaneEncoder<Plane>::model_other(const Value* row, const Value* row_above, std::size_t at, std::uint32_t lane,
                                      bool lane_begins) {
  const Value* above = rows_.above();
  Value* filled = rows_.current();
  for (std::size_t i = at; i < at + Plane::pixels; ++i) {
    const bool first = lane_begins && i == at;
    const bool left_read = (first ? row_above[i] : row[i - 1]) != Plane::none;
    const int beside = first ? above[i] : filled[i - 1];
    const std::uint32_t table = pixel_table<Plane>(row_above, i, left_read);
    if (row[i] == Plane::none) {
      note(lane, table, pixel_none);
      filled[i] = above[i];
      continue;
    }
    filled[i] = row[i];
    const int change = row[i] - beside;
    if (change >= -pixel_reach && change <= pixel_reach) {
      note(lane, table, pixel_zero + change);
    } else {
      note(lane, table, pixel_literal);
      *steps_end_++ = literal_flag | lane << lane_shift | row[i];
    }
  }
}

template <typename Plane>
void PlaneEncoder<Plane>::write_tables(std::vector<std::byte>& out) {
  entropy::BitWriter writer(out);
  std::array<bool, tables> own{};
  for (int table = 0; table < tables; ++table) {
    const auto& counts = counts_[table];
    const std::uint32_t total = std::accumulate(counts.begin(), counts.end(), 0U);
    own[table] = table < contexts ? total >= worth_a_table : total > 0;
    writer.put(own[table] ? 1 : 0, 1);
    if (table >= contexts || own[table]) continue;
    for (std::size_t i = 0; i < counts.size(); ++i) counts_[shared_table][i] += counts[i];
  }
  for (int table = 0; table < tables; ++table) {
    if (!own[table]) continue;
    const entropy::Frequencies frequencies = entropy::normalise(counts_[table]);
    entropy::write_table(writer, frequencies, symbols_of(table));
    std::uint16_t first = 0;
    for (std::size_t i = 0; i < frequencies.size(); ++i) {
      shares_[table][i] = {first, frequencies[i]};
      first = static_cast<std::uint16_t>(first + frequencies[i]);
    }
  }
  for (int table = 0; table < contexts; ++table) {
    if (!own[table]) shares_[table] = shares_[shared_table];
  }
  writer.finish();
}

template <typename Plane>
void PlaneEncoder<Plane>::write_symbols(std::vector<std::byte>& out) {
  std::byte* end = stream_.get() + most_stream_bytes<Plane>;
  entropy::BackwardWriter writer(end);
  std::array<std::uint32_t, lanes> states;
  states.fill(entropy::lowest_state);
  for (const std::uint32_t* step = steps_end_; step != steps_.get();) {
    const std::uint32_t what = *--step;
    std::uint32_t& state = states[what >> lane_shift & (lanes - 1)];
    if ((what & literal_flag) != 0) {
      writer.put_bits(state, what & 0xffff, Plane::value_bits);
    } else {
      writer.put(state, shares_[what >> table_shift & 0x1ff][what & 0xffff]);
    }
  }
  for (int lane = lanes - 1; lane >= 0; --lane) writer.put_state(states[lane]);
  out.insert(out.end(), writer.position(), static_cast<const std::byte*>(end));
}

template class PlaneEncoder<CodePlane>;
template class PlaneEncoder<DisparityPlane>;

}  // namespace iotcloud::drivers::depth::groups
