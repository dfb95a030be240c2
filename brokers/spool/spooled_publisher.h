#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>

namespace iotcloud::brokers {

namespace spool {
class Disk;
}

/// When a spool's files are put on the disk. Nothing of this matters when only the process dies (kill -9 included):
/// what was accepted is in its spool then.
enum class SpoolSync {
  never,     ///< when the operating system does so: a loss of power may cost the last half minute
  interval,  ///< SpoolOptions::interval: a loss of power costs no more than that
  always,    ///< before a message is accepted: a loss of power costs nothing, each publish() waits for the disk
};

/// What a spool that has no room does.
enum class SpoolFull {
  block,        ///< publish() answers would_block
  drop_oldest,  ///< the oldest give way, a sixteenth of the spool at a time: dropped, reason::spool_full
};

struct SpoolOptions {
  std::string folder;  ///< of this publisher alone; made when it is missing, removed at the end when nothing is left
  std::uint64_t max_bytes = std::uint64_t{256} << 20;  ///< on disk
  SpoolSync sync = SpoolSync::interval;
  std::chrono::milliseconds interval{100};
  SpoolFull when_full = SpoolFull::block;
  config::Labels labels;                 ///< of the metrics, beside the reason
  const config::Clock* clock = nullptr;  ///< nullptr: the system's
  config::Metrics* metrics = nullptr;    ///< nullptr: the process's
  spool::Disk* disk = nullptr;           ///< nullptr: the real one
};

/// A publisher whose messages survive: publish() writes each to a bounded log on disk before it accepts it, then passes
/// it on to a publisher of the broker, straight from memory while the broker keeps up, from disk after it was away. It
/// is done with when the broker has confirmed or refused it. What an earlier publisher left in the folder (its process
/// was killed, or it was closed) is sent first and arrives with `redelivered` set, because it may have been sent
/// before. Order is kept over it all.
///
/// As broker.h says of a Publisher, and besides:
/// - publish() waits for nothing but the disk. `options.when_full` is not used; `options.capacity` messages (and some
///   megabytes) are handed to the broker at a time, the rest is on disk only.
/// - A disk that is full or broken is as a spool without room: would_block, or dropped with reason::spool_failed.
/// - `options.deadline` counts from the first publish(), by wall time over restarts; what is too old is dropped when
///   its turn comes.
/// - Closing it keeps what is not done with; such messages end as Outcome::unknown with reason::spooled.
/// - Messages of an earlier process have no publish number here: on_outcome says 0. They count in pending() and
/// drain().
/// - A record that cannot be read any more is dropped with reason::spool_damaged, and its file is kept aside.
///
/// \throws config::Error when the folder cannot be used or another publisher has it.
std::unique_ptr<Publisher> make_spooled_publisher(Broker& broker, const Topic& topic, const PublisherOptions& options,
                                                  const SpoolOptions& spool);

}  // namespace iotcloud::brokers
