#pragma once

#include <cstddef>
#include <deque>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology::internal {

/// The keep_last of one input: of its waiting tuples the queue keeps the newest `keep` of each key.
struct KeepLast {
  const detail::StreamInfo* stream = nullptr;
  std::size_t keep = 1;
  std::vector<std::size_t> key;  ///< positions of the key's values in the tuple; empty: all tuples have one key
};

/// The queue of a bolt of which some inputs have keep_last. A key keeps its place in the queue: a newer tuple is
/// executed when the one that it replaces would have been. Not thread safe.
class Conflater {
 public:
  explicit Conflater(std::vector<KeepLast> inputs) : inputs_(std::move(inputs)) {}
  /// Adds a tuple. \return the tuple that it replaces, which the caller must ack and release, or nullptr.
  detail::TupleData* put(detail::TupleData* cell);
  detail::TupleData* take();  ///< removes the next tuple; nullptr: nothing waits
  /// The keep_last of a stream; nullptr: it has none, all its tuples wait.
  const KeepLast* find(const detail::StreamInfo* stream) const;

 private:
  using Kept = std::deque<detail::TupleData*>;
  struct Place {
    detail::TupleData* cell = nullptr;  ///< a tuple of an input without keep_last
    const std::string* key = nullptr;   ///< if `cell` is null: stands for the oldest tuple of this key
  };
  std::string key_of(const KeepLast& input, const detail::TupleData& cell) const;

  std::vector<KeepLast> inputs_;
  std::deque<Place> line_;
  std::unordered_map<std::string, Kept> by_key_;  ///< has only keys of which tuples wait
};

}  // namespace iotcloud::topology::internal
