#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/read_transport.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::client {

/// All subscriptions of one connection, for any kind of broker: hands received messages on to the handlers, the streams
/// in turn; applies keep_last; takes settlements; hands messages to be retried on again; and knows which settlements
/// the server was not told yet. It has no thread: the transport's thread runs the handlers.
///
/// One mutex guards the core and its transport. Handlers run without it. settle() and the other functions that users
/// call never wait for the network, because no transport holds the mutex during I/O.
class ReadCore {
 public:
  /// \param gathering_time how long settlements may gather, so that one acknowledgement covers many. The other
  /// arguments outlive the core.
  ReadCore(ReadTransport& transport, Meters& meters, const config::Clock& clock,
           std::chrono::milliseconds gathering_time);
  ReadCore(const ReadCore&) = delete;
  ReadCore& operator=(const ReadCore&) = delete;

  /// Held when the core calls the transport, and when the transport calls functions that require it.
  mutable config::Mutex mutex;

  // For subscriptions. These are thread safe.

  /// Settles a message. Ignored if it comes late: after the end of the tag's generation or of the subscription.
  void settle(DeliveryStream& stream, std::uint64_t public_tag, Settlement settlement) noexcept
      IOTCLOUD_REQUIRES(mutex);
  /// Nothing more is handed on to the subscription after its running handler.
  void pause(Subscriber& subscriber) IOTCLOUD_REQUIRES(mutex) { subscriber.paused = true; }
  /// Resumes the subscription that reads this stream.
  void resume(DeliveryStream& stream) IOTCLOUD_REQUIRES(mutex);
  /// Ends a subscription: nothing more is handed on to it, and its settlements are ignored from now on.
  void end(Subscriber& subscriber) IOTCLOUD_REQUIRES(mutex) { subscriber.closed = true; }
  /// Waits until the subscription's handler does not run, unless called from it.
  void await_handler(const Subscriber& subscriber) IOTCLOUD_REQUIRES(mutex);
  /// Waits until no handler runs with a message of these streams, at most until `end` on the injected clock. Not to be
  /// called from a handler.
  void await_handlers(const std::vector<std::shared_ptr<DeliveryStream>>& streams, config::Clock::Instant end)
      IOTCLOUD_REQUIRES(mutex);

  // For the transport.

  /// A message arrived. \return false if its tag is not the next one
  [[nodiscard]] bool arrived(DeliveryStream& stream, Arrived arrived) IOTCLOUD_REQUIRES(mutex);
  /// A message arrived that no handler should get: it counts as accepted.
  void skipped(DeliveryStream& stream) IOTCLOUD_REQUIRES(mutex);
  /// Applies keep_last: drops all waiting messages but the newest.
  void conflate(DeliveryStream& stream) IOTCLOUD_REQUIRES(mutex);
  /// Puts a stream into the list of ready ones if it has something to hand on.
  void make_ready(DeliveryStream& stream) IOTCLOUD_REQUIRES(mutex);
  /// Whether a stream may have something to hand on.
  bool has_ready() const IOTCLOUD_REQUIRES(mutex) { return !ready_.empty() && !stopped_; }
  /// Whether some thread has the Turn. If another thread asks while it holds the mutex: whether a handler runs.
  bool hands_on() const IOTCLOUD_REQUIRES(mutex) { return hands_on_ != std::thread::id(); }
  bool hands_on_here() const IOTCLOUD_REQUIRES(mutex) { return hands_on_ == std::this_thread::get_id(); }

  /// Makes this thread the one that hands messages on, as long as the object lives, unless another thread does.
  /// Construct and destroy it with the mutex held.
  class Turn {
   public:
    explicit Turn(ReadCore& core) IOTCLOUD_REQUIRES(core.mutex);
    ~Turn() IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS;  // the core's mutex is held, see above
    Turn(const Turn&) = delete;
    Turn& operator=(const Turn&) = delete;
    /// False if another thread has the Turn.
    explicit operator bool() const { return mine_; }

   private:
    friend class ReadCore;
    ReadCore& core_;
    const bool mine_;
    // What take() took. Kept until the next take(), so that the transport may use the stream after run().
    std::shared_ptr<DeliveryStream> stream_;
    std::shared_ptr<Subscriber> subscriber_;
    Arrived arrived_;
    std::uint64_t public_tag_ = 0;
  };
  /// Takes the next message from the stream whose turn it is; call run() afterwards. \return that stream; null if there
  /// is no message
  DeliveryStream* take(Turn& turn) IOTCLOUD_REQUIRES(mutex);
  /// Runs the handler of the message that was taken, without the mutex.
  void run(Turn& turn) IOTCLOUD_REQUIRES(mutex);

  /// The streams with settlements that the server was not told yet.
  const std::vector<std::shared_ptr<DeliveryStream>>& dirty() const IOTCLOUD_REQUIRES(mutex) { return dirty_; }
  /// Whether to tell the server now, because the settlements have gathered for long enough or many of one stream wait.
  bool settlements_due() const IOTCLOUD_REQUIRES(mutex);
  /// When the settlements have gathered for long enough; Instant::max(): there are none.
  config::Clock::Instant gathered_at() const IOTCLOUD_REQUIRES(mutex) {
    return dirty_.empty() ? config::Clock::Instant::max() : told_at_ + gathering_time_;
  }
  /// Empties the list of dirty streams and returns it. The transport tells the server their settlements now.
  std::vector<std::shared_ptr<DeliveryStream>> take_dirty() IOTCLOUD_REQUIRES(mutex);
  /// Takes one stream from that list.
  void take_dirty(DeliveryStream& stream) IOTCLOUD_REQUIRES(mutex);
  /// Lists a stream as dirty, because there is something to tell the server. \return whether it was not listed before
  bool make_dirty(DeliveryStream& stream) IOTCLOUD_REQUIRES(mutex);

  /// Removes a stream that moves to another core from all lists.
  void forget(DeliveryStream& stream) IOTCLOUD_REQUIRES(mutex);
  /// The connection is lost: empties the lists of ready and of dirty streams. The transport must also call
  /// DeliveryStream::begin_anew() or take_back() for each stream.
  void connection_lost() IOTCLOUD_REQUIRES(mutex);
  /// Ends the handing on for good. Returns when no handler runs; not to be called from a handler.
  void stop() IOTCLOUD_REQUIRES(mutex);

 private:
  void accept(DeliveryStream& stream, std::uint64_t tag) IOTCLOUD_REQUIRES(mutex);
  static void call(const Subscriber& subscriber, Arrived arrived, std::shared_ptr<Settler> settler, std::uint64_t tag);

  ReadTransport& transport_;
  Meters& meters_;
  const config::Clock& clock_;
  const std::chrono::milliseconds gathering_time_;

  config::ConditionVariable handler_ended_;
  bool stopped_ IOTCLOUD_GUARDED_BY(mutex) = false;
  std::thread::id hands_on_ IOTCLOUD_GUARDED_BY(mutex);  ///< the thread that has the Turn; default value: none
  std::deque<std::shared_ptr<DeliveryStream>> ready_ IOTCLOUD_GUARDED_BY(mutex);
  std::vector<std::shared_ptr<DeliveryStream>> dirty_ IOTCLOUD_GUARDED_BY(mutex);
  config::Clock::Instant told_at_ IOTCLOUD_GUARDED_BY(mutex){};  ///< when dirty_ was last taken
};

}  // namespace iotcloud::brokers::client
