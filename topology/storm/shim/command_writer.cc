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
  const std::size_t arrays = look_over(values, kept);
  const std::size_t size = 1 + 2 + 4 + 4 + anchors.size_bytes() + encoded_size(values, elsewhere_);
  std::byte* at =
      put(room(size, arrays), std::uint8_t{1}, stream, std::int32_t{task}, static_cast<std::uint32_t>(anchors.size()));
  for (const std::uint32_t slot : anchors) at = put(at, slot);
  write(values, at);
}

void CommandWriter::emit(std::uint16_t stream, int task, const std::uint64_t* id, std::span<const Value> values) {
  const std::size_t arrays = look_over(values, {});
  const std::size_t size = 1 + 2 + 4 + 1 + 8 + encoded_size(values, elsewhere_);
  std::byte* at = put(room(size, arrays), std::uint8_t{7}, stream, std::int32_t{task},
                      static_cast<std::uint8_t>(id != nullptr ? 1 : 0), id != nullptr ? *id : std::uint64_t{0});
  write(values, at);
}

std::size_t CommandWriter::look_over(std::span<const Value> values, JavaValues kept) {
  elsewhere_.assign(kept.begin(), kept.end());
  std::size_t bytes = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto* payload = std::get_if<Payload>(&values[i]);
    if (payload == nullptr || payload->size() < least_array || (i < elsewhere_.size() && elsewhere_[i])) continue;
    elsewhere_.resize(std::max(elsewhere_.size(), i + 1));
    elsewhere_[i] = JavaValue{};
    bytes += payload->size();
  }
  return bytes;
}

void CommandWriter::write(std::span<const Value> values, std::byte* at) {
  for (std::size_t i = 0; i < elsewhere_.size(); ++i) {
    if (elsewhere_[i] && elsewhere_[i]->slot == JavaValue::next_array)
      sink_.add_array(std::get<Payload>(values[i]).bytes());
  }
  encode_values(values, at, elsewhere_);
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
