#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology::internal {

/// Computes the watermark. For each task and stream that feeds the bolt it keeps the latest time stamp; the watermark
/// is the least of these, minus the lag. It is unknown until every input has sent a tuple. Not thread safe.
class Watermarks {
 public:
  /// \param inputs how many streams the bolt subscribes to. \param idle_ms ignores a source that was silent for this
  /// long; 0: never. \param now_ms processing time, as in the calls below.
  Watermarks(std::size_t inputs, std::int64_t lag_ms, std::int64_t idle_ms, std::int64_t now_ms)
      : inputs_(inputs), lag_ms_(lag_ms), idle_ms_(idle_ms), began_ms_(now_ms) {}

  /// Takes a tuple's time stamp into account.
  void heard(const Tuple& tuple, std::int64_t time_ms, std::int64_t now_ms) {
    const detail::StreamInfo* stream = tuple.data()->stream;
    Source& source = sources_.try_emplace({stream, tuple.source_task()}, Source{time_ms, now_ms}).first->second;
    if (source.latest_ms < time_ms) source.latest_ms = time_ms;
    source.heard_ms = now_ms;
    streams_.insert(stream);
  }
  /// Moves the watermark forward, never back. \return nullopt while it is unknown.
  std::optional<std::int64_t> update(std::int64_t now_ms) {
    const bool waiting = streams_.size() < inputs_ && (idle_ms_ == 0 || now_ms - began_ms_ < idle_ms_);
    if (waiting) return watermark_;
    std::optional<std::int64_t> least;
    for (const auto& [key, source] : sources_) {
      if (idle_ms_ != 0 && now_ms - source.heard_ms >= idle_ms_) continue;
      if (!least || source.latest_ms < *least) least = source.latest_ms;
    }
    if (least && (!watermark_ || *watermark_ < *least - lag_ms_)) watermark_ = *least - lag_ms_;
    return watermark_;
  }
  /// Whether a tuple with this time stamp is behind the watermark.
  bool late(std::int64_t time_ms) const { return watermark_ && time_ms < *watermark_; }

 private:
  struct Source {
    std::int64_t latest_ms;
    std::int64_t heard_ms;
  };
  const std::size_t inputs_;
  const std::int64_t lag_ms_, idle_ms_, began_ms_;
  std::map<std::pair<const detail::StreamInfo*, int>, Source> sources_;
  std::set<const detail::StreamInfo*> streams_;  ///< streams that have sent a tuple
  std::optional<std::int64_t> watermark_;
};

}  // namespace iotcloud::topology::internal
