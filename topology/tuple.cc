#include <cstring>

#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology {

const char* kind_of(const Value& value) {
  static constexpr const char* kinds[] = {"null", "bool", "int", "double", "string", "payload"};
  return kinds[value.index()];
}

std::uint64_t stable_hash(const Value& value, std::uint64_t seed) {
  std::uint64_t hash = seed;
  const auto add = [&hash](const void* data, std::size_t size) {
    const auto* bytes = static_cast<const unsigned char*>(data);
    for (std::size_t i = 0; i < size; ++i) hash = (hash ^ bytes[i]) * 1099511628211ULL;
  };
  const auto add_word = [&add](std::uint64_t word) {
    unsigned char bytes[8];
    for (int i = 0; i < 8; ++i) bytes[i] = static_cast<unsigned char>(word >> (8 * i));
    add(bytes, sizeof bytes);
  };
  const auto kind = static_cast<unsigned char>(value.index());
  add(&kind, 1);
  if (const auto* b = std::get_if<bool>(&value)) {
    const unsigned char byte = *b ? 1 : 0;
    add(&byte, 1);
  } else if (const auto* i = std::get_if<std::int64_t>(&value)) {
    add_word(static_cast<std::uint64_t>(*i));
  } else if (const auto* d = std::get_if<double>(&value)) {
    const double canonical = *d == 0 ? 0.0 : *d;
    std::uint64_t word = 0;
    std::memcpy(&word, &canonical, sizeof word);
    add_word(word);
  } else if (const auto* s = std::get_if<std::string>(&value)) {
    add(s->data(), s->size());
  } else if (const auto* p = std::get_if<Payload>(&value)) {
    add(p->data(), p->size());
  }
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

void Tuple::wrong_kind(const Value& value, std::string_view field, const char* wanted) const {
  throw std::invalid_argument("field \"" + std::string(field) + "\" of " + source_component() + "/" + source_stream() +
                              " is of kind " + kind_of(value) + ", not " + wanted);
}

}  // namespace iotcloud::topology
