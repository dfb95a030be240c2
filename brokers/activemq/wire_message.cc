#include "iotcloud/brokers/activemq/wire_message.h"

#include <charconv>
#include <cstring>
#include <map>
#include <string_view>
#include <utility>

#include <fmt/core.h>
#include <proton/binary.hpp>
#include <proton/codec/map.hpp>
#include <proton/codec/vector.hpp>
#include <proton/duration.hpp>
#include <proton/error.hpp>
#include <proton/symbol.hpp>
#include <proton/timestamp.hpp>
#include <proton/value.hpp>

#include "iotcloud/brokers/activemq/names.h"

namespace iotcloud::brokers::activemq {
namespace {

// The words of the original system, so that its programs read ours (REFERENCE.md 4).
constexpr std::string_view driver_property = "sensorID";
constexpr std::string_view gateway_property = "siteID";
constexpr std::string_view time_property = "time";
// Our own.
constexpr std::string_view index_property = "iotcloud_properties";
constexpr std::string_view resent_property = "iotcloud_resent";

bool reserved(std::string_view name) {
  return name == driver_property || name == gateway_property || name == time_property || name == index_property ||
         name == resent_property;
}

/// Length of the UTF-8 character at the start of `text`; 0 when there is none.
std::size_t character_at(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned char first = byte(0);
  if (first < 0x80) return 1;
  const std::size_t length = first >= 0xf0 ? 4 : first >= 0xe0 ? 3 : 2;
  if (first < 0xc2 || first > 0xf4 || text.size() < length) return 0;
  for (std::size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xc0U) != 0x80) return 0;
  }
  const bool overlong = (first == 0xe0 && byte(1) < 0xa0) || (first == 0xf0 && byte(1) < 0x90);
  const bool surrogate = first == 0xed && byte(1) >= 0xa0;
  const bool too_large = first == 0xf4 && byte(1) >= 0x90;
  return overlong || surrogate || too_large ? 0 : length;
}

bool is_utf8(std::string_view text) {
  while (!text.empty()) {
    const std::size_t length = character_at(text);
    if (length == 0) return false;
    text.remove_prefix(length);
  }
  return true;
}

/// Whether a JMS server carries a property of this name as it is, without giving it a meaning.
bool plain_name(std::string_view name) {
  if (name.empty() || name.starts_with("JMS") || name.starts_with("AMQ_") || !is_utf8(name)) return false;
  return name.find('\0') == std::string_view::npos;
}

/// The text of the index: entries in order, joined by '&'; "name" for what stands in a property of its own,
/// "name=value" for what stands only here.
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

/// nullopt for what has no sensible text: maps, lists, arrays.
std::optional<std::string> text_of(const proton::value& value) {
  switch (value.type()) {
    case proton::NULL_TYPE:
      return std::string();
    case proton::STRING:
    case proton::SYMBOL:
      return proton::coerce<std::string>(value);
    case proton::BINARY: {
      const auto bytes = proton::get<proton::binary>(value);
      return std::string(bytes.begin(), bytes.end());
    }
    case proton::BOOLEAN:
      return proton::get<bool>(value) ? "true" : "false";
    case proton::UBYTE:
    case proton::USHORT:
    case proton::UINT:
    case proton::ULONG:
      return fmt::format("{}", proton::coerce<std::uint64_t>(value));
    case proton::BYTE:
    case proton::SHORT:
    case proton::INT:
    case proton::LONG:
      return fmt::format("{}", proton::coerce<std::int64_t>(value));
    case proton::TIMESTAMP:
      return fmt::format("{}", proton::get<proton::timestamp>(value).milliseconds());
    case proton::FLOAT:
      return fmt::format("{}", proton::get<float>(value));
    case proton::DOUBLE:
      return fmt::format("{}", proton::get<double>(value));
    default:
      return std::nullopt;
  }
}

std::int64_t number_of(std::string_view text) {
  std::int64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  return error == std::errc() && end == text.data() + text.size() ? number : 0;
}

std::map<std::string, std::string> properties_of(const proton::message& wire) {
  std::map<std::string, std::string> texts;
  const proton::value& all = wire.properties().value();
  if (all.empty() || all.type() != proton::MAP) return texts;
  std::map<proton::value, proton::value> entries;
  proton::get(all, entries);
  for (const auto& [name, value] : entries) {
    const std::optional<std::string> key = text_of(name);
    std::optional<std::string> text = text_of(value);
    if (key && text) texts.emplace(*key, std::move(*text));
  }
  return texts;
}

std::string taken(std::map<std::string, std::string>& texts, std::string_view name) {
  const auto node = texts.extract(std::string(name));
  return node.empty() ? std::string() : node.mapped();
}

void apply_index(std::string_view index, std::map<std::string, std::string>& texts, Message& message) {
  while (!index.empty()) {
    const std::string_view entry = index.substr(0, index.find('&'));
    index.remove_prefix(std::min(index.size(), entry.size() + 1));
    const auto equals = entry.find('=');
    const std::string name = percent_decode(entry.substr(0, equals));
    if (equals == std::string_view::npos) {
      const auto node = texts.extract(name);
      if (!node.empty()) message.properties.set(name, node.mapped());
      continue;
    }
    std::string value = percent_decode(entry.substr(equals + 1));
    if (name == driver_property) {
      message.driver_id = std::move(value);
    } else if (name == gateway_property) {
      message.gateway_id = std::move(value);
    } else {
      message.properties.set(name, value);
    }
  }
}

std::optional<Payload> payload_of(const proton::message& wire) {
  const proton::value& body = wire.body();
  if (body.empty()) return Payload();
  if (body.type() == proton::BINARY) {
    auto bytes = proton::get<proton::binary>(body);
    if (bytes.empty()) return Payload();
    return Payload::take(std::vector<std::uint8_t>(std::move(bytes)));
  }
  const std::optional<std::string> text = text_of(body);
  if (!text) return std::nullopt;
  return Payload::copy(*text);
}

}  // namespace

proton::message to_wire(const Message& message, const Envelope& envelope) {
  proton::message wire;
  proton::binary body;
  if (!message.payload.empty()) {
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(message.payload.data());
    body.assign(bytes, bytes + message.payload.size());
  }
  wire.inferred(true);  // a data section: a BytesMessage for JMS
  wire.body() = body;
  wire.to(envelope.to);
  wire.durable(envelope.durable);
  wire.priority(envelope.priority);
  if (envelope.expires_in.count() > 0) {
    wire.ttl(proton::duration(static_cast<proton::duration::numeric_type>(envelope.expires_in.count())));
  }
  Index index;
  std::map<std::string, proton::scalar> properties;
  const auto put = [&](std::string_view name, std::string_view value) { properties.emplace(name, std::string(value)); };
  const auto put_id = [&](std::string_view name, const std::string& value) {
    if (is_utf8(value)) {
      put(name, value);
    } else {
      index.add(name, value);
    }
  };
  put_id(driver_property, message.driver_id);
  if (!message.gateway_id.empty()) put_id(gateway_property, message.gateway_id);
  put(time_property, std::to_string(message.time_ms));
  if (envelope.resent) put(resent_property, "1");
  for (const auto& [name, value] : message.properties) {
    if (reserved(name)) continue;
    if (plain_name(name) && is_utf8(value)) {
      put(name, value);
      index.add(name);
    } else {
      index.add(name, value);
    }
  }
  if (index.needed()) put(index_property, index.text());
  wire.properties() = properties;
  return wire;
}

namespace {

client::Arrived arrived_of(const proton::message& wire, Payload payload) {
  client::Arrived arrived;
  arrived.message.payload = std::move(payload);
  std::map<std::string, std::string> texts = properties_of(wire);
  arrived.message.driver_id = taken(texts, driver_property);
  arrived.message.gateway_id = taken(texts, gateway_property);
  arrived.message.time_ms = number_of(taken(texts, time_property));
  arrived.redelivered = !taken(texts, resent_property).empty() || wire.delivery_count() > 0;
  apply_index(taken(texts, index_property), texts, arrived.message);
  for (const auto& [name, value] : texts) arrived.message.properties.set(name, value);
  return arrived;
}

}  // namespace

std::optional<client::Arrived> from_wire(const proton::message& wire) {
  try {
    std::optional<Payload> payload = payload_of(wire);
    if (!payload) return std::nullopt;
    return arrived_of(wire, std::move(*payload));
  } catch (const proton::error&) {  // types that the specification forbids
    return std::nullopt;
  }
}

}  // namespace iotcloud::brokers::activemq
