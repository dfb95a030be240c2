#include <algorithm>
#include <cstring>
#include <utility>
#include <variant>

#include <iotcloud/topology/storm/shim/command_writer.h>

namespace iotcloud::topology::storm {

namespace {

template <typename... Numbers>
std::byte* put(std::byte* at, Numbers... numbers) {
  (
      [&](auto number) {
        std::memcpy(at, &number, sizeof number);
        at += sizeof number;
      }(numbers),
      ...);
  return at;
}

}  // namespace

void CommandWriter::emit(std::uint16_t stream, int task, std::span<const std::uint32_t> anchors,
                         std::span<const Value> values, JavaValues kept) {
  elsewhere_.assign(kept.begin(), kept.end());
  const std::size_t arrays = find_arrays(values, elsewhere_);
  write(values, begin_emit(stream, task, anchors, encoded_size(values, elsewhere_), arrays));
}

void CommandWriter::emit(std::uint16_t stream, int task, const std::uint64_t* id, std::span<const Value> values) {
  elsewhere_.clear();
  const std::size_t arrays = find_arrays(values, elsewhere_);
  write(values, begin_emit(stream, task, id, encoded_size(values, elsewhere_), arrays));
}

void CommandWriter::emit(std::uint16_t stream, int task, std::span<const std::uint32_t> anchors, ParcelPtr&& parcel,
                         std::span<const std::size_t> told) {
  write(std::move(parcel), told, begin_emit(stream, task, anchors, encoded_parcel_size(parcel->values.all(), told), 0));
}

void CommandWriter::emit(std::uint16_t stream, int task, const std::uint64_t* id, ParcelPtr&& parcel,
                         std::span<const std::size_t> told) {
  write(std::move(parcel), told, begin_emit(stream, task, id, encoded_parcel_size(parcel->values.all(), told), 0));
}

std::byte* CommandWriter::begin_emit(std::uint16_t stream, int task, std::span<const std::uint32_t> anchors,
                                     std::size_t values, std::size_t arrays) {
  std::byte* at = put(room(1 + 2 + 4 + 4 + anchors.size_bytes() + values, arrays), std::uint8_t{1}, stream,
                      std::int32_t{task}, static_cast<std::uint32_t>(anchors.size()));
  for (const std::uint32_t slot : anchors) at = put(at, slot);
  return at;
}

std::byte* CommandWriter::begin_emit(std::uint16_t stream, int task, const std::uint64_t* id, std::size_t values,
                                     std::size_t arrays) {
  return put(room(1 + 2 + 4 + 1 + 8 + values, arrays), std::uint8_t{7}, stream, std::int32_t{task},
             static_cast<std::uint8_t>(id != nullptr ? 1 : 0), id != nullptr ? *id : std::uint64_t{0});
}

void CommandWriter::write(std::span<const Value> values, std::byte* at) {
  for (std::size_t i = 0; i < elsewhere_.size(); ++i) {
    if (elsewhere_[i] && elsewhere_[i]->slot == JavaValue::next_array)
      sink_.add_array(std::get<Payload>(values[i]).bytes());
  }
  encode_values(values, at, elsewhere_);
}

void CommandWriter::write(ParcelPtr&& parcel, std::span<const std::size_t> told, std::byte* at) noexcept {
  const Parcel& packed = *parcel.release();
  encode_parcel(&packed, packed.count(), packed.values.all(), told, at);
}

void CommandWriter::error(std::string_view text) {
  std::byte* at = put(room(1 + 4 + text.size()), std::uint8_t{6}, static_cast<std::uint32_t>(text.size()));
  std::memcpy(at, text.data(), text.size());
}

void CommandWriter::about(std::uint8_t kind, std::uint32_t slot) {
  put(room(1 + 4), kind, slot);
}

std::byte* CommandWriter::room(std::size_t size, std::size_t arrays) {
  // Arrays count, too, so that a call that emits many does not fill Java's heap.
  if (size > buffer_.size() - used_ || arrays > buffer_.size() - std::min(arrays_, buffer_.size())) {
    if (used_ > 0) sink_.apply(take());
    if (size > buffer_.size()) buffer_ = sink_.grow(size);
  }
  std::byte* at = buffer_.data() + used_;
  used_ += size;
  arrays_ += arrays;
  return at;
}

std::size_t CommandWriter::take() {
  arrays_ = 0;
  return std::exchange(used_, 0);
}

}  // namespace iotcloud::topology::storm
