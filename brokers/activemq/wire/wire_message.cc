#include "iotcloud/brokers/activemq/wire/wire_message.h"

#include <algorithm>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include <fmt/core.h>

#include "iotcloud/brokers/activemq/names.h"
#include "iotcloud/brokers/activemq/wire/amqp_value.h"
#include "iotcloud/brokers/activemq/wire/sections.h"
#include <iotcloud/brokers/limits.h>
#include <iotcloud/brokers/metadata_names.h>
#include <iotcloud/config/number.h>
#include <iotcloud/config/utf8.h>

namespace iotcloud::brokers::activemq {
namespace {

// Names that only this project uses.
constexpr std::string_view index_property = "iotcloud_properties";
constexpr std::string_view resent_property = "iotcloud_resent";

bool reserved(std::string_view name) {
  return metadata::is_original(name) || name == index_property || name == resent_property;
}

/// Whether a JMS server passes a property of this name on unchanged and gives it no meaning.
bool plain_name(std::string_view name) {
  if (name.empty() || name.starts_with("JMS") || name.starts_with("AMQ_") || !config::is_utf8(name)) return false;
  return name.find('\0') == std::string_view::npos;
}

/// The index property: entries in order, joined by '&'. An entry is "name" for a property of its own, and "name=value"
/// for one that only the index carries.
class Index {
 public:
  void add(std::string_view name) {
    if (count_++ > 0) text_ += '&';
    text_ += percent_encode(name, "-_.");
  }
  void add(std::string_view name, std::string_view value) {
    add(name);
    text_ += '=';
    text_ += percent_encode(value, "-_.");
    needed_ = true;
  }
  bool needed() const { return needed_ || count_ > 1; }
  const std::string& text() const { return text_; }

 private:
  std::string text_;
  std::size_t count_ = 0;
  bool needed_ = false;
};

/// nullopt for kinds without a useful text: maps, lists, arrays.
std::optional<std::string> text_of(const AmqpValue& value) {
  switch (value.kind) {
    case AmqpValue::Kind::null:
      return std::string();
    case AmqpValue::Kind::text:
    case AmqpValue::Kind::binary:
      return std::string(value.bytes);
    case AmqpValue::Kind::boolean:
      return value.number != 0 ? "true" : "false";
    case AmqpValue::Kind::unsigned_number:
      return std::to_string(value.number);
    case AmqpValue::Kind::signed_number:
    case AmqpValue::Kind::timestamp:
      return std::to_string(value.signed_number());
    case AmqpValue::Kind::single_real:
      return fmt::format("{}", static_cast<float>(value.real));
    case AmqpValue::Kind::double_real:
      return fmt::format("{}", value.real);
    default:
      return std::nullopt;
  }
}

std::int64_t number_of(std::string_view text) {
  return config::parse_number<std::int64_t>(text).value_or(0);
}

/// The properties that have a text form, in the order received.
using Texts = std::vector<std::pair<std::string, std::string>>;

Texts properties_of(const AmqpValue& map) {
  if (map.elements / 2 > max_received_properties) throw MalformedAmqp("too many properties");
  Texts texts;
  AmqpReader entries(map.bytes);
  for (std::size_t i = 0; i < map.elements; i += 2) {
    std::optional<std::string> name = text_of(entries.read());
    std::optional<std::string> text = text_of(entries.read());
    if (name && text) texts.emplace_back(std::move(*name), std::move(*text));
  }
  return texts;
}

std::optional<std::string> taken(Texts& texts, std::string_view name) {
  const auto found = std::find_if(texts.begin(), texts.end(), [&](const auto& entry) { return entry.first == name; });
  if (found == texts.end()) return std::nullopt;
  std::string text = std::move(found->second);
  texts.erase(found);
  return text;
}

void apply_index(std::string_view index, Texts& texts, Message& message) {
  while (!index.empty()) {
    const std::string_view entry = index.substr(0, index.find('&'));
    index.remove_prefix(std::min(index.size(), entry.size() + 1));
    const auto equals = entry.find('=');
    const std::string name = percent_decode(entry.substr(0, equals));
    if (equals == std::string_view::npos) {
      if (const auto text = taken(texts, name)) message.properties.set(name, *text);
      continue;
    }
    std::string value = percent_decode(entry.substr(equals + 1));
    if (name == metadata::driver) {
      message.driver_id = std::move(value);
    } else if (name == metadata::gateway) {
      message.gateway_id = std::move(value);
    } else {
      message.properties.set(name, value);
    }
  }
}

/// The payload refers to `bytes`, unless the body has several parts.
std::optional<Payload> payload_of(const Sections& sections, const WireBytes& bytes) {
  const auto wrap = [&](std::string_view body) {
    return body.empty() ? Payload() : Payload::wrap(bytes.owner, std::as_bytes(std::span(body)));
  };
  switch (sections.body) {
    case Sections::Body::none:
      return Payload();
    case Sections::Body::data: {
      if (sections.data.size() == 1) return wrap(sections.data.front());
      std::string all;
      for (const std::string_view part : sections.data) all += part;
      return Payload::copy(all);
    }
    case Sections::Body::value: {
      if (sections.value.kind == AmqpValue::Kind::binary) return wrap(sections.value.bytes);
      const std::optional<std::string> text = text_of(sections.value);
      if (!text) return std::nullopt;
      return Payload::copy(*text);
    }
    default:
      return std::nullopt;
  }
}

void write_header(AmqpWriter& writer, const Envelope& envelope) {
  writer.descriptor(static_cast<std::uint8_t>(Section::header));
  const std::size_t header = writer.begin_list();
  writer.boolean(envelope.durable);
  writer.octet(envelope.priority);
  const bool expires = envelope.expires_in.count() > 0;
  if (expires) {
    writer.number(static_cast<std::uint32_t>(
        std::min<std::int64_t>(envelope.expires_in.count(), std::numeric_limits<std::uint32_t>::max())));
  }
  writer.end(header, expires ? 3 : 2);
}

void write_address(AmqpWriter& writer, const std::string& to) {
  writer.descriptor(static_cast<std::uint8_t>(Section::properties));
  const std::size_t properties = writer.begin_list();
  writer.null();  // message id
  writer.null();  // user
  writer.text(to);
  writer.end(properties, 3);
}

void write_properties(AmqpWriter& writer, const Message& message, bool resent) {
  writer.descriptor(static_cast<std::uint8_t>(Section::application_properties));
  const std::size_t map = writer.begin_map();
  std::size_t count = 0;
  Index index;
  const auto put = [&](std::string_view name, std::string_view value) {
    writer.text(name);
    writer.text(value);
    count += 2;
  };
  const auto put_id = [&](std::string_view name, const std::string& value) {
    if (config::is_utf8(value)) {
      put(name, value);
    } else {
      index.add(name, value);
    }
  };
  put_id(metadata::driver, message.driver_id);
  if (!message.gateway_id.empty()) put_id(metadata::gateway, message.gateway_id);
  put(metadata::time, std::to_string(message.time_ms));
  if (resent) put(resent_property, "1");
  for (const auto& [name, value] : message.properties) {
    if (reserved(name)) continue;
    if (plain_name(name) && config::is_utf8(value)) {
      put(name, value);
      index.add(name);
    } else {
      index.add(name, value);
    }
  }
  if (index.needed()) put(index_property, index.text());
  writer.end(map, count);
}

client::Arrived arrived_of(const Sections& sections, Payload payload) {
  client::Arrived arrived;
  arrived.message.payload = std::move(payload);
  Texts texts = properties_of(sections.application_properties);
  arrived.message.driver_id = taken(texts, metadata::driver).value_or("");
  arrived.message.gateway_id = taken(texts, metadata::gateway).value_or("");
  arrived.message.time_ms = number_of(taken(texts, metadata::time).value_or(""));
  arrived.redelivered = !taken(texts, resent_property).value_or("").empty() || sections.delivery_count > 0;
  if (const auto index = taken(texts, index_property)) apply_index(*index, texts, arrived.message);
  for (const auto& [name, value] : texts) arrived.message.properties.set(name, value);
  return arrived;
}

}  // namespace

void write_head(const Message& message, const Envelope& envelope, std::string& out) {
  AmqpWriter writer(out);
  write_header(writer, envelope);
  write_address(writer, envelope.to);
  write_properties(writer, message, envelope.resent);
  writer.descriptor(static_cast<std::uint8_t>(Section::data));  // JMS programs see a BytesMessage
  writer.binary_head(message.payload.size());
}

std::optional<client::Arrived> from_wire(const WireBytes& bytes) {
  try {
    const Sections sections = read_sections(bytes.text);
    std::optional<Payload> payload = payload_of(sections, bytes);
    if (!payload) return std::nullopt;
    return arrived_of(sections, std::move(*payload));
  } catch (const MalformedAmqp&) {
    return std::nullopt;
  }
}

}  // namespace iotcloud::brokers::activemq
