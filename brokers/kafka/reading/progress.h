#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "iotcloud/brokers/client/ack_window.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::kafka {

using client::AckWindow;
using client::Arrived;

/// A group's progress in a partition, as the server keeps it.
struct Committed {
  std::int64_t offset = -1;  ///< the first unsettled offset; below 0: nothing was committed yet
  std::string metadata;      ///< our own text beside it, see Progress, or what another member wrote; at most 4096 bytes
  bool known = true;         ///< false: the server did not say what the group has committed
};

/// One reader's way through one partition: received messages, settled ones, and what to commit. Kafka keeps one number
/// for a group, which is the first unsettled offset here. The text beside it lists settled offsets behind it and, at an
/// orderly end, how far messages were handed on: so the next reader skips the settled ones and knows which may have
/// been handed on before. Not thread safe.
class Progress {
 public:
  /// \param handed_on the first offset that this process, as far as it knows, has not handed on
  Progress(const Committed& committed, std::int64_t handed_on);

  /// The first offset to read; below 0: the oldest in the partition, or, unless placed(), what the server says later.
  std::int64_t start() const { return start_; }
  /// Whether the group's place is known: what it has committed, or the first record that has arrived.
  bool placed() const { return placed_; }
  /// The first offset that has not arrived.
  std::int64_t expects() const { return next_; }
  /// Whether an earlier reader settled this offset, although one before it was unsettled.
  bool was_settled(std::int64_t offset) const;
  /// Whether an earlier reader may have handed on this offset. \param log_end the end of the partition as known now: if
  /// the earlier reader ended without a farewell, every offset up to it (at the first call) is doubtful.
  bool maybe_handed_on(std::int64_t offset, std::int64_t log_end);
  /// True only while maybe_handed_on() uses `log_end`.
  bool wants_log_end() const { return doubtful_ && !doubtful_to_; }

  void arrived(std::int64_t offset, Message message, bool redelivered);
  /// For an offset without a message to handle: settled already, too old, or undecodable.
  void skipped(std::int64_t offset);
  std::size_t waiting() const { return window_.waiting(); }
  std::size_t unsettled() const { return window_.size() - window_.settled(); }
  std::size_t size() const { return window_.size(); }
  Arrived next() { return window_.next(); }
  bool settle(std::uint64_t tag, Settlement settlement) { return window_.settle(tag, settlement); }
  void return_all() { window_.return_all(); }
  /// The window that holds the messages, for the ReadCore.
  AckWindow& window() { return window_; }
  /// The first offset that was not handed on.
  std::int64_t handed_on() const;

  /// The offset to commit now; nullopt if it was committed already, or unless placed(): the group's place would be
  /// overwritten. \param final nothing more is handed on
  std::optional<Committed> to_commit(bool final);
  /// The last commit did not reach the server.
  void commit_failed() { committed_.reset(); }

 private:
  using Range = std::pair<std::int64_t, std::int64_t>;  ///< both ends included
  void read_metadata(const Committed& committed);
  void note(std::int64_t offset);
  std::string metadata(std::int64_t offset, bool final) const;

  std::int64_t start_;
  std::int64_t next_;  ///< the first offset that has not arrived
  bool placed_;
  /// The first offset that was not handed on, among deliveries that have left the window; see handed_on().
  std::int64_t handed_on_;
  bool doubtful_ = false;                    ///< an earlier reader may have handed on anything
  std::optional<std::int64_t> doubtful_to_;  ///< the first offset that is not doubtful
  std::vector<Range> settled_before_;        ///< ascending
  AckWindow window_;
  std::deque<std::int64_t> offsets_;  ///< the offsets of the deliveries in the window
  std::uint64_t first_tag_ = 1;       ///< of offsets_.front()
  std::optional<std::pair<std::int64_t, std::string>> committed_;
};

}  // namespace iotcloud::brokers::kafka
