#include <algorithm>

#include <iotcloud/topology/endpoints/receiving/unit_readers.h>

namespace iotcloud::topology {

void UnitReaders::keep_only(const Wanted& wanted) {
  for (auto place = readers_.begin(); place != readers_.end();) {
    if (wanted.contains(place->first)) {
      ++place;
      continue;
    }
    place->second->close();
    place = readers_.erase(place);
    --totals_.open;
  }
}

void UnitReaders::open_missing(const Wanted& wanted, const Open& open) {
  std::size_t missing = 0;
  for (const auto& [key, channel] : wanted) {
    if (readers_.contains(key)) continue;
    if (auto reader = open(*channel, key)) {
      readers_[key] = std::move(reader);
      ++totals_.open;
    } else {
      ++missing;
    }
  }
  set_missing(missing);
}

void UnitReaders::set_missing(std::size_t count) {
  totals_.missing = totals_.missing - missing_ + count;
  missing_ = count;
}

void UnitReaders::drain() {
  for (const auto& [key, reader] : readers_) reader->drain();
}

std::size_t UnitReaders::in_hand() const {
  std::size_t sum = 0;
  for (const auto& [key, reader] : readers_) sum += reader->in_hand();
  return sum;
}

std::size_t UnitReaders::at_limit() const {
  return static_cast<std::size_t>(
      std::count_if(readers_.begin(), readers_.end(), [](const auto& entry) { return entry.second->at_limit(); }));
}

std::size_t UnitReaders::prefetch() const {
  std::size_t most = 0;
  for (const auto& [key, reader] : readers_) most = std::max(most, reader->prefetch());
  return most;
}

std::size_t UnitReaders::ask_backlog() {
  for (const auto& [key, reader] : readers_) reader->ask_backlog();
  return readers_.size();
}

void UnitReaders::add_backlog(Backlog& sum) const {
  for (const auto& [key, reader] : readers_) {
    if (const auto backlog = reader->backlog()) sum.add(reader->topic().name, *backlog);
  }
}

std::size_t UnitReaders::taken() const {
  std::size_t sum = 0;
  for (const auto& [key, reader] : readers_) sum += reader->taken();
  return sum;
}

bool UnitReaders::cut_off() const {
  return std::any_of(readers_.begin(), readers_.end(), [](const auto& entry) { return !entry.second->active(); });
}

void UnitReaders::close() {
  for (const auto& [key, reader] : readers_) reader->close();
  totals_.open -= readers_.size();
  set_missing(0);
  readers_.clear();
}

}  // namespace iotcloud::topology
