#include <algorithm>

#include <iotcloud/topology/windows/window_buffer.h>

namespace iotcloud::topology::internal {

WindowBuffer::WindowBuffer(WindowExtent length, WindowExtent slide, std::int64_t origin_ms)
    : length_(length), slide_(slide), origin_ms_(origin_ms), next_count_(slide.count) {}

void WindowBuffer::add(std::int64_t time_ms, const Tuple& tuple) {
  auto place = entries_.end();
  if (!entries_.empty() && entries_.back().time_ms > time_ms) {
    place = std::upper_bound(entries_.begin(), entries_.end(), time_ms,
                             [](std::int64_t time, const Entry& entry) { return time < entry.time_ms; });
  }
  entries_.insert(place, Entry{time_ms, tuple, false});
  if (!slide_.counts() && (!next_end_ || end_after(time_ms) < *next_end_)) next_end_ = end_after(time_ms);
}

void WindowBuffer::advance(std::int64_t time_ms, Listener& listener) {
  if (slide_.counts()) {
    advance_by_count(time_ms, listener);
  } else {
    advance_by_time(time_ms, listener);
  }
}

void WindowBuffer::advance_by_count(std::int64_t time_ms, Listener& listener) {
  while (next_count_ <= dropped_ + static_cast<std::int64_t>(entries_.size())) {
    const auto to = static_cast<std::size_t>(next_count_ - dropped_);
    // Entries with this time stamp are complete: a later one with the same stamp comes after them.
    const std::int64_t end_ms = entries_[to - 1].time_ms;
    if (end_ms > time_ms) return;
    const auto from = length_.counts()
                          ? static_cast<std::size_t>(std::max<std::int64_t>(0, next_count_ - length_.count - dropped_))
                          : std::min(first_not_before(end_ms - length_.duration.count() + 1), to);
    next_count_ += slide_.count;
    const std::int64_t before = dropped_;
    if (!evaluate(from, to, end_ms + 1, listener) || !length_.counts()) continue;
    // Releases the entries before the next window's begin, as far as this window reaches.
    const std::int64_t end_of_this = before + static_cast<std::int64_t>(to);
    drop_first(static_cast<std::size_t>(
                   std::max<std::int64_t>(0, std::min(next_count_ - length_.count, end_of_this) - dropped_)),
               listener);
  }
}

void WindowBuffer::advance_by_time(std::int64_t time_ms, Listener& listener) {
  while (next_end_ && *next_end_ <= time_ms) {
    const std::int64_t end = *next_end_;
    const std::size_t to = first_not_before(end);
    std::size_t from = 0;
    if (!length_.counts()) {
      from = first_not_before(end - length_.duration.count());
    } else if (to > static_cast<std::size_t>(length_.count)) {
      from = to - static_cast<std::size_t>(length_.count);
    }
    if (evaluate(from, to, end, listener) && !length_.counts()) {
      const std::int64_t kept_from = end + slide_.duration.count() - length_.duration.count();
      drop_first(first_not_before(std::min(kept_from, end)), listener);
    }
    next_end_ = next_end(end, time_ms);
  }
}

std::optional<std::int64_t> WindowBuffer::next_end(std::int64_t end, std::int64_t time_ms) const {
  if (entries_.empty()) return std::nullopt;
  const std::int64_t following = end + slide_.duration.count();
  if (!length_.counts()) return std::max(following, end_after(entries_.front().time_ms));
  // Windows that end before the first new tuples hold the same tuples: when time jumps, only the last of them matters.
  const std::size_t fresh = first_not_before(end);
  const std::int64_t last = end_after(time_ms) - slide_.duration.count();
  return std::max(following, fresh == entries_.size() ? last : std::min(last, end_after(entries_[fresh].time_ms)));
}

std::int64_t WindowBuffer::end_after(std::int64_t time_ms) const {
  const std::int64_t slide = slide_.duration.count();
  std::int64_t into = (time_ms - origin_ms_) % slide;
  if (into < 0) into += slide;
  return time_ms - into + slide;
}

std::size_t WindowBuffer::first_not_before(std::int64_t time_ms) const {
  return static_cast<std::size_t>(
      std::lower_bound(entries_.begin(), entries_.end(), time_ms,
                       [](const Entry& entry, std::int64_t time) { return entry.time_ms < time; }) -
      entries_.begin());
}

bool WindowBuffer::evaluate(std::size_t from, std::size_t to, std::int64_t end_ms, Listener& listener) {
  drop_first(from, listener);
  const std::size_t size = to - from;
  if (size == 0) return true;
  tuples_.clear();
  added_.clear();
  for (std::size_t i = 0; i < size; ++i) {
    tuples_.push_back(entries_[i].tuple);
    if (!entries_[i].seen) added_.push_back(entries_[i].tuple);
    entries_[i].seen = true;
  }
  const bool by_time = !length_.counts();
  const TupleWindow window(tuples_, added_, expired_, by_time ? end_ms - length_.duration.count() : entries_[0].time_ms,
                           by_time ? end_ms : entries_[size - 1].time_ms);
  const bool good = listener.evaluate(window);
  expired_.clear();
  if (!good) {
    entries_.erase(entries_.begin(), entries_.begin() + static_cast<std::ptrdiff_t>(size));
    dropped_ += static_cast<std::int64_t>(size);
    for (const Tuple& tuple : tuples_) listener.failed(tuple);
  }
  tuples_.clear();
  added_.clear();
  return good;
}

void WindowBuffer::drop_first(std::size_t count, Listener& listener) {
  for (std::size_t i = 0; i < count; ++i) {
    Entry entry = std::move(entries_.front());
    entries_.pop_front();
    ++dropped_;
    listener.done(entry.tuple);
    if (entry.seen) expired_.push_back(std::move(entry.tuple));
  }
}

}  // namespace iotcloud::topology::internal
