#include <cstring>
#include <utility>

#include <iotcloud/topology/storm/shim/command_writer.h>
#include <iotcloud/topology/storm/value_format.h>

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
                         std::span<const Value> values) {
  const std::size_t size = 1 + 2 + 4 + 4 + anchors.size_bytes() + encoded_size(values);
  std::byte* at =
      put(room(size), std::uint8_t{1}, stream, std::int32_t{task}, static_cast<std::uint32_t>(anchors.size()));
  for (const std::uint32_t slot : anchors) at = put(at, slot);
  encode_values(values, at);
}

void CommandWriter::emit(std::uint16_t stream, int task, const std::uint64_t* id, std::span<const Value> values) {
  const std::size_t size = 1 + 2 + 4 + 1 + 8 + encoded_size(values);
  std::byte* at = put(room(size), std::uint8_t{7}, stream, std::int32_t{task},
                      static_cast<std::uint8_t>(id != nullptr ? 1 : 0), id != nullptr ? *id : std::uint64_t{0});
  encode_values(values, at);
}

void CommandWriter::error(std::string_view text) {
  std::byte* at = put(room(1 + 4 + text.size()), std::uint8_t{6}, static_cast<std::uint32_t>(text.size()));
  std::memcpy(at, text.data(), text.size());
}

void CommandWriter::about(std::uint8_t kind, std::uint32_t slot) {
  put(room(1 + 4), kind, slot);
}

std::byte* CommandWriter::room(std::size_t size) {
  if (size > buffer_.size() - used_) {
    if (used_ > 0) sink_.apply(std::exchange(used_, 0));
    if (size > buffer_.size()) buffer_ = sink_.grow(size);
  }
  std::byte* at = buffer_.data() + used_;
  used_ += size;
  return at;
}

std::size_t CommandWriter::take() {
  return std::exchange(used_, 0);
}

}  // namespace iotcloud::topology::storm
