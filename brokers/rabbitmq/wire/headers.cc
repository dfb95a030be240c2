#include "iotcloud/brokers/rabbitmq/wire/headers.h"

#include <charconv>
#include <optional>
#include <string_view>

#include <fmt/format.h>

#include <iotcloud/brokers/metadata_names.h>
#include <iotcloud/config/number.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

amqp_bytes_t view(std::string_view text) {
  amqp_bytes_t bytes;
  bytes.len = text.size();
  bytes.bytes = const_cast<char*>(text.data());  // the library takes only non-const pointers but does not write
  return bytes;
}

std::string_view view(amqp_bytes_t bytes) {
  return bytes.len == 0 ? std::string_view() : std::string_view(static_cast<const char*>(bytes.bytes), bytes.len);
}

bool reserved(std::string_view name) {
  return metadata::is_original(name) || name == metadata::resent_header;
}

/// nullopt for kinds without a useful text: tables, arrays, decimals.
std::optional<std::string> text_of(const amqp_field_value_t& field) {
  switch (field.kind) {
    case AMQP_FIELD_KIND_UTF8:
    case AMQP_FIELD_KIND_BYTES:
      return std::string(view(field.value.bytes));
    case AMQP_FIELD_KIND_BOOLEAN:
      return field.value.boolean != 0 ? "true" : "false";
    case AMQP_FIELD_KIND_I8:
      return fmt::format("{}", static_cast<int>(field.value.i8));
    case AMQP_FIELD_KIND_U8:
      return fmt::format("{}", static_cast<unsigned>(field.value.u8));
    case AMQP_FIELD_KIND_I16:
      return fmt::format("{}", field.value.i16);
    case AMQP_FIELD_KIND_U16:
      return fmt::format("{}", field.value.u16);
    case AMQP_FIELD_KIND_I32:
      return fmt::format("{}", field.value.i32);
    case AMQP_FIELD_KIND_U32:
      return fmt::format("{}", field.value.u32);
    case AMQP_FIELD_KIND_I64:
      return fmt::format("{}", field.value.i64);
    case AMQP_FIELD_KIND_U64:
    case AMQP_FIELD_KIND_TIMESTAMP:
      return fmt::format("{}", field.value.u64);
    case AMQP_FIELD_KIND_F32:
      return fmt::format("{}", field.value.f32);
    case AMQP_FIELD_KIND_F64:
      return fmt::format("{}", field.value.f64);
    case AMQP_FIELD_KIND_VOID:
      return std::string();
    default:
      return std::nullopt;
  }
}

}  // namespace

amqp_bytes_t MessageProperties::Digits::of(std::int64_t number) {
  const std::to_chars_result done = std::to_chars(text_.data(), text_.data() + text_.size(), number);
  return {static_cast<std::size_t>(done.ptr - text_.data()), text_.data()};
}

void MessageProperties::add(amqp_bytes_t name, amqp_bytes_t value) {
  amqp_table_entry_t entry{};
  entry.key = name;
  entry.value.kind = AMQP_FIELD_KIND_UTF8;
  entry.value.value.bytes = value;
  entries_.push_back(entry);
}

const amqp_basic_properties_t& MessageProperties::encode(const Message& message, const SendOptions& options) {
  properties_ = {};
  entries_.clear();
  entries_.reserve(message.properties.size() + 4);
  add(view(metadata::driver), view(message.driver_id));
  if (!message.gateway_id.empty()) add(view(metadata::gateway), view(message.gateway_id));
  add(view(metadata::time), time_.of(message.time_ms));
  if (options.resent) add(view(metadata::resent_header), view(std::string_view("1")));
  for (const auto& [name, value] : message.properties) {
    if (!reserved(name)) add(view(name), view(value));
  }
  properties_.headers = {static_cast<int>(entries_.size()), entries_.data()};
  properties_.delivery_mode = options.durable ? AMQP_DELIVERY_PERSISTENT : AMQP_DELIVERY_NONPERSISTENT;
  const char* const end =
      fmt::format_to(message_id_.data(), "{:016x}-{}", options.origin.publisher, options.origin.number);
  properties_.message_id = {static_cast<std::size_t>(end - message_id_.data()), message_id_.data()};
  properties_._flags = AMQP_BASIC_HEADERS_FLAG | AMQP_BASIC_DELIVERY_MODE_FLAG | AMQP_BASIC_MESSAGE_ID_FLAG;
  if (options.priority != normal_priority) {
    properties_.priority = options.priority;
    properties_._flags |= AMQP_BASIC_PRIORITY_FLAG;
  }
  if (options.expires_in.count() > 0) {
    properties_.expiration = expiration_.of(options.expires_in.count());
    properties_._flags |= AMQP_BASIC_EXPIRATION_FLAG;
  }
  return properties_;
}

bool decode_properties(const amqp_basic_properties_t& properties, Message& message) {
  bool resent = false;
  if ((properties._flags & AMQP_BASIC_HEADERS_FLAG) == 0) return resent;
  for (int i = 0; i < properties.headers.num_entries; ++i) {
    const amqp_table_entry_t& entry = properties.headers.entries[i];
    const std::string_view name = view(entry.key);
    std::optional<std::string> value = text_of(entry.value);
    if (!value) continue;
    if (name == metadata::driver) {
      message.driver_id = std::move(*value);
    } else if (name == metadata::gateway) {
      message.gateway_id = std::move(*value);
    } else if (name == metadata::time) {
      message.time_ms = config::parse_number<std::int64_t>(*value).value_or(0);
    } else if (name == metadata::resent_header) {
      resent = true;
    } else {
      message.properties.set(name, *value);
    }
  }
  return resent;
}

std::optional<MessageOrigin> origin_of(const amqp_basic_properties_t& properties) {
  constexpr std::size_t publisher_digits = 16;
  if ((properties._flags & AMQP_BASIC_MESSAGE_ID_FLAG) == 0) return std::nullopt;
  const std::string_view id = view(properties.message_id);
  if (id.size() <= publisher_digits || id[publisher_digits] != '-') return std::nullopt;
  const auto publisher = config::parse_number<std::uint64_t>(id.substr(0, publisher_digits), 16);
  const auto number = config::parse_number<std::uint64_t>(id.substr(publisher_digits + 1));
  if (!publisher || !number) return std::nullopt;
  return MessageOrigin{*publisher, *number};
}

}  // namespace iotcloud::brokers::rabbitmq
