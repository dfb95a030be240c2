#pragma once

#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/spool/ledger.h"
#include "iotcloud/brokers/spool/spool_meters.h"
#include "iotcloud/brokers/spool/spool_thread.h"
#include "iotcloud/brokers/spool/store/spool_reader.h"
#include "iotcloud/brokers/spool/store/spool_store.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/brokers/spool/spooled_publisher.h>

namespace iotcloud::brokers::spool {

/// What is behind a spooled publisher. Shared, because callbacks of the inner publisher and the spools' thread may be
/// in it while it is closed.
///
/// Threads: callers of publish(), one at a time under `order_`; the inner publisher's callbacks; the spools' thread.
/// Either the caller of publish() or the spools' thread hands messages to the inner publisher, whoever has `sending_`:
/// the caller when its message is the next to be sent, the spools' thread when some wait on disk.
class SpoolQueue final : public Served, public std::enable_shared_from_this<SpoolQueue> {
 public:
  /// \throws config::Error, see make_spooled_publisher.
  SpoolQueue(const Topic& topic, const PublisherOptions& options, const SpoolOptions& spool);
  ~SpoolQueue() override = default;

  void open(Broker& broker);
  void close();
  PublishStatus publish(Message message);
  bool drain(std::chrono::milliseconds limit);
  std::size_t pending() const;

  std::optional<Time> serve() noexcept override;

 private:
  using Lock = std::unique_lock<std::mutex>;
  enum class Stored { yes, no_room, never };

  void tell_found();
  PublisherOptions inner_options();
  Stored store(const Message& message, std::int64_t now_ms, Position& where);
  /// The next message goes to the inner publisher; `sending_` is the caller's. \return whether it took it
  bool send(Message message, const Past& past, Lock& lock);
  bool may_send() const;
  /// Hands on some of what waits on disk.
  void send_waiting(Lock& lock);
  /// Reads until the record that is to be sent next; what turns out to be lost or too old is dropped.
  std::optional<Record> next_waiting(Lock& lock);
  void on_inner_outcome(std::uint64_t number, Outcome outcome, const std::string& reason);
  void on_inner_writable();
  void count(std::uint64_t dropped, const char* reason);
  /// Puts files on the disk and removes them.
  void tidy(Lock& lock);
  std::optional<Time> next_time() const;
  /// Calls the user's callbacks, unless another thread does. Never waits: a callback may be closing the publisher, and
  /// wait for this thread.
  void report(Lock& lock);
  void wake() { thread_->wake(*this); }
  std::int64_t now_ms() const;

  const Topic topic_;
  const PublisherOptions options_;
  const SpoolOptions spool_;
  const config::Clock& clock_;
  const std::shared_ptr<SpoolThread> thread_ = SpoolThread::of_process();

  std::mutex order_;           ///< taken before mutex_
  SpoolStore store_;           ///< appended to under order_
  bool disk_failing_ = false;  ///< said in the log; guarded by order_

  // Of the one who has sending_.
  std::unique_ptr<Publisher> inner_;
  SpoolReader reader_{store_};
  std::optional<Record> held_;  ///< read, and not taken by the inner publisher

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  // All below: guarded by mutex_.
  Ledger ledger_;
  SpoolMeters meters_;
  bool closed_ = false;
  bool sending_ = false;
  bool inner_full_ = false;            ///< its on_writable will follow
  std::optional<Position> wait_from_;  ///< where the spools' thread begins to read
  std::uint64_t unwritten_marks_ = 0;  ///< outcomes since the mark was written
  bool dirty_ = false;                 ///< something is to be put on the disk
  bool sync_failing_ = false;          ///< said in the log
  Time sync_at_{};
  std::optional<std::uint64_t> wanted_room_;  ///< said would_block to so many bytes
  std::optional<Time> retry_at_;              ///< the disk that was full or broken may take something then
  bool writable_due_ = false;
  std::optional<std::thread::id> reporting_;
};

}  // namespace iotcloud::brokers::spool
