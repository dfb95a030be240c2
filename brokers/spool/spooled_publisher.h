#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>

namespace iotcloud::brokers {

namespace spool {
class Disk;
}

/// When the spools' thread syncs a spool's files to the disk; publish() never waits for it. This matters only if power
/// fails: accepted messages survive the death of the process (also by kill -9) in any case.
enum class SpoolSync {
  never,     ///< the operating system decides: a loss of power may cost the last half minute
  interval,  ///< every SpoolOptions::interval: a loss of power costs no more than that
  /// At once, all messages since the last sync together: a loss of power costs only messages whose sync is under way,
  /// which SpoolOptions::on_stored has not reported. After a failed sync, publish() accepts no message until a sync
  /// succeeds.
  always,
};

/// The policies of publish() when the spool has no room.
enum class SpoolFull {
  block,        ///< publish() answers would_block
  drop_oldest,  ///< the oldest messages are dropped, a sixteenth of the spool at a time, with reason::spool_full
};

/// Where a spool is, how large it may become, and when it is synced.
struct SpoolOptions {
  std::string folder;  ///< belongs to this publisher alone; made if missing, removed at the end if it is empty
  std::uint64_t max_bytes = std::uint64_t{256} << 20;  ///< on disk
  SpoolSync sync = SpoolSync::interval;
  std::chrono::milliseconds interval{100};
  SpoolFull when_full = SpoolFull::block;
  /// Called when a loss of power cannot cost any message up to this publish number any more (1, 2, 3, ... as in
  /// PublisherOptions::on_outcome): each is on the disk or has its outcome. Called with SpoolSync::interval and always,
  /// with rising numbers, once for many messages, from any thread but never from inside publish(), one call at a time.
  /// May be empty. A caller whose source deletes acknowledged messages acknowledges them here.
  std::function<void(std::uint64_t number)> on_stored;
  config::Labels labels;                 ///< labels of the metrics, besides the reason
  const config::Clock* clock = nullptr;  ///< nullptr: the system's
  config::Metrics* metrics = nullptr;    ///< nullptr: the process's
  spool::Disk* disk = nullptr;           ///< nullptr: the real one
};

/// Makes a publisher whose messages survive the process. publish() writes each message to a bounded log on disk before
/// it accepts it, and then passes it to a publisher of the broker: from memory while the broker keeps up, from disk
/// after an outage. A message is finished when the broker has confirmed or refused it. Messages that an earlier
/// publisher left in the folder (its process was killed, or it was closed) are sent first, with `redelivered` set,
/// because they may have been sent before. Order is kept throughout.
///
/// The contract of Publisher (broker.h) holds, and besides:
/// - publish() waits for no sync: it writes to the system's memory of the file. `options.when_full` is not used; the
/// broker gets `options.capacity` messages (and some megabytes) at a time, the rest is on disk only.
/// - A full or broken disk counts as a full spool: would_block, or dropped with reason::spool_failed.
/// - `options.deadline` counts from the first publish(): by the steady clock, and for messages of an earlier process by
/// the time of day. Expired messages are dropped when their turn comes.
/// - Closing keeps unfinished messages in the spool; they end as Outcome::unknown with reason::spooled.
/// - Messages of an earlier process have no publish number: on_outcome gets 0. They count in pending() and drain().
/// - An unreadable record is dropped with reason::spool_damaged, and its file is kept aside.
///
/// \throws config::Error if the folder cannot be used or another publisher has it.
std::unique_ptr<Publisher> make_spooled_publisher(Broker& broker, const Topic& topic, const PublisherOptions& options,
                                                  const SpoolOptions& spool);

}  // namespace iotcloud::brokers
