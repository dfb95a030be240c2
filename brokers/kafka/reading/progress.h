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

/// How far a group has come with a partition: what the server keeps for it.
struct Committed {
  std::int64_t offset = -1;  ///< the first that is not settled; below 0: nothing was committed yet
  std::string metadata;      ///< our own text beside it, see Progress; at most 4096 bytes
};

/// One reader's way through one partition: what came, what of it is settled, and what to commit. Kafka keeps one number
/// for a group, so that number is the first unsettled offset; which ones behind it are settled goes into the text
/// beside it, as does, at an orderly end, how far messages were handed on: the next reader skips the settled ones, and
/// knows which may have been handed on before. Not thread safe.
class Progress {
 public:
  /// \param handed_on the first offset that this process never handed on, as far as it knows
  Progress(const Committed& committed, std::int64_t handed_on);

  /// The first offset to read; below 0: the oldest there is.
  std::int64_t start() const { return start_; }
  /// Whether a reader before settled it, although what lies before it was not.
  bool was_settled(std::int64_t offset) const;
  /// Whether a reader before may have handed it on. \param log_end the end of the partition as known now: if the reader
  /// before ended without a word, everything up to it (at the first call) is doubtful.
  bool maybe_handed_on(std::int64_t offset, std::int64_t log_end);
  /// Only then does maybe_handed_on() look at `log_end`.
  bool wants_log_end() const { return doubtful_ && !doubtful_to_; }

  void arrived(std::int64_t offset, Message message, bool redelivered);
  /// Needs no handling: settled already, too old, not to be understood.
  void skipped(std::int64_t offset);
  std::size_t waiting() const { return window_.waiting(); }
  std::size_t unsettled() const { return window_.size() - window_.settled(); }
  std::size_t size() const { return window_.size(); }
  Arrived next();
  bool settle(std::uint64_t tag, Settlement settlement) { return window_.settle(tag, settlement); }
  void return_all() { window_.return_all(); }
  /// The first offset that was never handed on.
  std::int64_t handed_on() const { return handed_on_; }

  /// What to commit now; nothing when that was committed already. \param final no more is handed on
  std::optional<Committed> to_commit(bool final);
  /// The last one did not reach the server.
  void commit_failed() { committed_.reset(); }

 private:
  using Range = std::pair<std::int64_t, std::int64_t>;  ///< both ends included
  void read_metadata(const Committed& committed);
  void note(std::int64_t offset);
  std::string metadata(std::int64_t offset, bool final) const;

  std::int64_t start_;
  std::int64_t next_;                        ///< the first offset that did not come yet
  std::int64_t handed_on_;                   ///< see handed_on()
  bool doubtful_ = false;                    ///< the reader before may have handed on anything
  std::optional<std::int64_t> doubtful_to_;  ///< the first offset that is not doubtful
  std::vector<Range> settled_before_;        ///< ascending
  AckWindow window_;
  std::deque<std::int64_t> offsets_;  ///< of the deliveries in the window
  std::uint64_t first_tag_ = 1;       ///< of offsets_.front()
  std::optional<std::pair<std::int64_t, std::string>> committed_;
};

}  // namespace iotcloud::brokers::kafka
