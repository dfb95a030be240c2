#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/spool/accept_times.h"
#include "iotcloud/brokers/spool/ledger.h"
#include "iotcloud/brokers/spool/spool_meters.h"
#include "iotcloud/brokers/spool/spool_thread.h"
#include "iotcloud/brokers/spool/store/spool_reader.h"
#include "iotcloud/brokers/spool/store/spool_store.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/brokers/spool/spooled_publisher.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::spool {

/// Implements a spooled publisher. It is a shared object, because callbacks of the inner publisher (that of the broker)
/// and the spools' thread may use it while the publisher is closed.
///
/// Three kinds of threads use it: callers of publish(), one at a time under `order_`; the inner publisher's callbacks;
/// and the spools' thread. The thread that has set `sending_` passes messages to the inner publisher: the caller of
/// publish() if its message is the next one, and the spools' thread if messages wait on disk.
class SpoolQueue final : public ServedSpool, public std::enable_shared_from_this<SpoolQueue> {
 public:
  /// \throws config::Error, see make_spooled_publisher.
  SpoolQueue(const Topic& topic, const PublisherOptions& options, const SpoolOptions& spool);
  ~SpoolQueue() override = default;

  void open(Broker& broker);
  void close();
  Published publish(Message message);
  bool drain(std::chrono::milliseconds limit);
  std::size_t pending() const;
  std::optional<config::Clock::Instant> oldest() const;

  std::optional<Time> serve() noexcept override;

 private:
  enum class Stored { yes, no_room, never };
  /// While it lives, its thread alone may pass messages to the inner publisher (`sending_`).
  class Sending;

  /// Logs and counts what the store found in the folder.
  void tell_found();
  PublisherOptions inner_options();
  Stored store(const Message& message, std::int64_t accepted_ms, Position& where) IOTCLOUD_REQUIRES(order_);
  /// Passes the next message to the inner publisher; releases the mutex meanwhile. \return whether that one accepted
  /// it. \param accepted when the message was accepted
  bool send(Message message, const Past& past, config::Clock::Instant accepted) IOTCLOUD_REQUIRES(mutex_, sender_);
  bool may_send() const IOTCLOUD_REQUIRES(mutex_);
  /// Passes some of the messages that wait on disk to the inner publisher; releases the mutex at times.
  void send_waiting() IOTCLOUD_REQUIRES(mutex_);
  /// Reads the record that is to be sent next, and drops those before it that are unreadable or past their deadline.
  /// Releases the mutex at times.
  std::optional<Record> next_waiting() IOTCLOUD_REQUIRES(mutex_, sender_);
  void on_inner_outcome(std::uint64_t number, Outcome outcome, const std::string& reason);
  void on_inner_writable();
  void count(std::uint64_t dropped, const char* reason) IOTCLOUD_REQUIRES(mutex_);
  /// Plans a sync of what was written.
  void sync_soon() IOTCLOUD_REQUIRES(mutex_);
  /// Whether publish() must refuse messages, because the last sync failed and SpoolSync::always promises syncs.
  bool sync_stuck() const IOTCLOUD_REQUIRES(mutex_) { return sync_failing_ && spool_.sync == SpoolSync::always; }
  /// Writes the mark, syncs, and removes finished files, as is due; releases the mutex meanwhile.
  void tidy() IOTCLOUD_REQUIRES(mutex_);
  /// Computes the publish number up to which a loss of power cannot lose a message any more.
  void note_stored() IOTCLOUD_REQUIRES(mutex_);
  std::optional<Time> next_time() const IOTCLOUD_REQUIRES(mutex_);
  /// Calls the user's callbacks, unless another thread does; releases the mutex meanwhile. It never waits for that
  /// other thread, because a callback there may close the publisher, which waits for this thread.
  void report() IOTCLOUD_REQUIRES(mutex_);
  void tell(const std::vector<Ledger::Event>& events, std::uint64_t stored, bool writable) IOTCLOUD_EXCLUDES(mutex_);
  void wake() { thread_->wake(*this); }
  Time now() const { return clock_.now(); }
  /// How long ago a record's message was accepted: one of an earlier process by the time of day, which is all that the
  /// record has of it.
  std::chrono::milliseconds age_of(const Record& record, config::Clock::Instant now) const IOTCLOUD_REQUIRES(mutex_);

  const Topic topic_;
  const PublisherOptions options_;
  const SpoolOptions spool_;
  const config::Clock& clock_;
  const std::shared_ptr<SpoolThread> thread_;

  config::Mutex order_ IOTCLOUD_ACQUIRED_BEFORE(mutex_);
  SpoolStore store_;                                       ///< order_ guards appending to it
  bool disk_failing_ IOTCLOUD_GUARDED_BY(order_) = false;  ///< the last write failed, which was logged
  /// False after the oldest messages were dropped for a full disk and it still took no message. Nothing more is dropped
  /// for the disk until it takes one.
  bool dropping_helps_ IOTCLOUD_GUARDED_BY(order_) = true;

  config::ThreadRole sender_;  ///< the role of the thread that has set sending_
  std::unique_ptr<Publisher> inner_ IOTCLOUD_GUARDED_BY(sender_);
  SpoolReader reader_ IOTCLOUD_GUARDED_BY(sender_){store_};
  std::optional<Record> held_ IOTCLOUD_GUARDED_BY(sender_);  ///< was read, but the inner publisher did not accept it

  mutable config::Mutex mutex_;
  config::ConditionVariable changed_;
  Ledger ledger_ IOTCLOUD_GUARDED_BY(mutex_);
  AcceptTimes accept_times_ IOTCLOUD_GUARDED_BY(mutex_);
  SpoolMeters meters_;  ///< mutex_ guards calls of level()
  bool closed_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool sending_ IOTCLOUD_GUARDED_BY(mutex_) = false;               ///< a thread passes messages to the inner publisher
  bool inner_full_ IOTCLOUD_GUARDED_BY(mutex_) = false;            ///< the inner publisher will call on_writable
  std::optional<Position> wait_from_ IOTCLOUD_GUARDED_BY(mutex_);  ///< where the spools' thread begins to read
  std::uint64_t unwritten_marks_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< number of outcomes since the mark was written
  bool dirty_ IOTCLOUD_GUARDED_BY(mutex_) = false;                 ///< a sync is planned for sync_at_
  Time sync_at_ IOTCLOUD_GUARDED_BY(mutex_){};
  bool sync_failing_ IOTCLOUD_GUARDED_BY(mutex_) = false;        ///< the last sync failed, which was logged
  std::uint64_t synced_ IOTCLOUD_GUARDED_BY(mutex_) = 0;         ///< records below this were synced
  std::uint64_t doubtful_ IOTCLOUD_GUARDED_BY(mutex_) = 0;       ///< some records below this failed to sync
  std::uint64_t stored_number_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< the next argument of on_stored
  std::uint64_t stored_told_ IOTCLOUD_GUARDED_BY(mutex_) = 0;    ///< its last argument
  /// publish() answered would_block for a message of this size; nullopt: it did not. 0: because syncs fail.
  std::optional<std::uint64_t> wanted_room_ IOTCLOUD_GUARDED_BY(mutex_);
  /// When on_writable is called after the disk was full or broken, so that the user tries again.
  std::optional<Time> retry_at_ IOTCLOUD_GUARDED_BY(mutex_);
  bool writable_due_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::optional<std::thread::id> reporting_ IOTCLOUD_GUARDED_BY(mutex_);  ///< the thread in report()
};

}  // namespace iotcloud::brokers::spool
