#include <cstring>

#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology {

const char* kind_of(const Value& value) {
  static constexpr const char* kinds[] = {"null", "bool", "int", "double", "string", "payload"};
  return kinds[value.index()];
}

namespace {

/// A step of FNV-1a for each byte.
[[gnu::always_inline]] inline std::uint64_t add_bytes(std::uint64_t hash, const void* data, std::size_t size) {
  const auto* bytes = static_cast<const unsigned char*>(data);
#pragma GCC unroll 4
  for (std::size_t i = 0; i < size; ++i) hash = (hash ^ bytes[i]) * 1099511628211ULL;
  return hash;
}

std::uint64_t add_word(std::uint64_t hash, std::uint64_t word) {
  unsigned char bytes[8];
  for (int i = 0; i < 8; ++i) bytes[i] = static_cast<unsigned char>(word >> (8 * i));
  return add_bytes(hash, bytes, sizeof bytes);
}

}  // namespace

std::uint64_t stable_hash(const Value& value, std::uint64_t seed) {
  const auto kind = static_cast<unsigned char>(value.index());
  const std::uint64_t hash = add_bytes(seed, &kind, 1);
  if (const auto* s = std::get_if<std::string>(&value)) return add_bytes(hash, s->data(), s->size());
  if (const auto* i = std::get_if<std::int64_t>(&value)) return add_word(hash, static_cast<std::uint64_t>(*i));
  if (const auto* d = std::get_if<double>(&value)) {
    const double canonical = *d == 0 ? 0.0 : *d;
    std::uint64_t word = 0;
    std::memcpy(&word, &canonical, sizeof word);
    return add_word(hash, word);
  }
  if (const auto* b = std::get_if<bool>(&value)) {
    const unsigned char byte = *b ? 1 : 0;
    return add_bytes(hash, &byte, 1);
  }
  if (const auto* p = std::get_if<Payload>(&value)) return add_bytes(hash, p->data(), p->size());
  return hash;
}

bool Tuple::is_tick() const {
  return source_component() == system_component && source_stream() == tick_stream;
}

void Tuple::no_field(std::size_t i) const {
  throw std::out_of_range("a tuple of " + source_component() + "/" + source_stream() + " has no field number " +
                          std::to_string(i) + "; it has " + std::to_string(size()) + ": " + fields().list());
}

const Value& Tuple::at(std::string_view field) const {
  if (const auto i = fields().find(field)) return data_->values[*i];
  throw std::out_of_range("a tuple of " + source_component() + "/" + source_stream() + " has no field \"" +
                          std::string(field) + "\"; it has: " + fields().list());
}

void Tuple::wrong_kind(const Value& value, const char* wanted) const {
  const auto i = static_cast<std::size_t>(&value - &data_->values[0]);
  const std::string field = i < fields().size() ? fields()[i] : "";
  throw std::invalid_argument("field \"" + field + "\" of " + source_component() + "/" + source_stream() +
                              " is of kind " + kind_of(value) + ", not " + wanted);
}

}  // namespace iotcloud::topology
