#include <algorithm>
#include <cstdint>

#include <iotcloud/topology/runtime/tasks/conflater.h>

namespace iotcloud::topology::internal {

namespace {

void append_bytes(std::string& key, const void* data, std::size_t size) {
  key.append(static_cast<const char*>(data), size);
}

/// Appends the kind, and before a string's or payload's bytes their number, so that different values never give equal
/// keys.
void append_value(std::string& key, const Value& value) {
  key.push_back(static_cast<char>(value.index()));
  const auto append_sized = [&key](const void* data, std::size_t size) {
    append_bytes(key, &size, sizeof size);
    append_bytes(key, data, size);
  };
  if (const auto* b = std::get_if<bool>(&value)) key.push_back(*b ? 1 : 0);
  if (const auto* i = std::get_if<std::int64_t>(&value)) append_bytes(key, i, sizeof *i);
  if (const auto* d = std::get_if<double>(&value)) append_bytes(key, d, sizeof *d);
  if (const auto* s = std::get_if<std::string>(&value)) append_sized(s->data(), s->size());
  if (const auto* p = std::get_if<Payload>(&value)) append_sized(p->data(), p->size());
}

}  // namespace

const KeepLast* Conflater::find(const detail::StreamInfo* stream) const {
  const auto input = std::find_if(inputs_.begin(), inputs_.end(), [&](const auto& i) { return i.stream == stream; });
  return input == inputs_.end() ? nullptr : &*input;
}

std::string Conflater::key_of(const KeepLast& input, const detail::TupleData& cell) const {
  // Two inputs may have equal keys: the stream's address tells them apart.
  const auto stream = reinterpret_cast<std::uintptr_t>(input.stream);
  std::string key;
  append_bytes(key, &stream, sizeof stream);
  for (const std::size_t position : input.key) append_value(key, cell.values[position]);
  return key;
}

detail::TupleData* Conflater::put(detail::TupleData* cell) {
  const KeepLast* input = find(cell->stream);
  if (input == nullptr) {
    line_.push_back({cell, nullptr});
    return nullptr;
  }
  // the map never moves its keys, so line_ may point to them
  const auto at = by_key_.try_emplace(key_of(*input, *cell)).first;
  Kept& kept = at->second;
  kept.push_back(cell);
  if (kept.size() <= input->keep) {
    line_.push_back({nullptr, &at->first});
    return nullptr;
  }
  detail::TupleData* oldest = kept.front();
  kept.pop_front();
  return oldest;
}

detail::TupleData* Conflater::take() {
  if (line_.empty()) return nullptr;
  const Place place = line_.front();
  line_.pop_front();
  if (place.cell != nullptr) return place.cell;
  const auto at = by_key_.find(*place.key);
  detail::TupleData* cell = at->second.front();
  at->second.pop_front();
  if (at->second.empty()) by_key_.erase(at);
  return cell;
}

}  // namespace iotcloud::topology::internal
