#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <list>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "iotcloud/brokers/client/outbox.h"
#include "iotcloud/brokers/client/outbox_timers.h"
#include "iotcloud/brokers/client/publish_transport.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::client {

/// All publishers of one connection, for any kind of broker: accepts messages, queues them, drops expired ones, sends
/// as many as the transport has room for, keeps track of unanswered ones, sends these again after a lost connection,
/// and reports outcomes. It has no thread: publish() sends on the caller's thread if that cannot block, and the
/// transport's thread does the rest.
///
/// One mutex guards the core and its transport. Callbacks of publishers run without it.
class PublishCore {
 public:
  /// All arguments outlive the core.
  PublishCore(PublishTransport& transport, Meters& meters, const config::Clock& clock);
  PublishCore(const PublishCore&) = delete;
  PublishCore& operator=(const PublishCore&) = delete;

  /// Held when the core calls the transport, and when the transport calls functions that require it.
  mutable config::Mutex mutex;

  // For publishers. These are thread safe.

  std::shared_ptr<Outbox> add(const Topic& topic, const PublisherOptions& options) IOTCLOUD_EXCLUDES(mutex);
  /// Closes the publisher: reports messages without an outcome as `unknown`, and waits for running callbacks, unless
  /// called from one of them.
  void remove(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_EXCLUDES(mutex);
  Published publish(const std::shared_ptr<Outbox>& outbox, Message message, const Past& past) IOTCLOUD_EXCLUDES(mutex);
  /// Waits until the outcomes of all accepted messages were reported. A callback may destroy the publisher meanwhile.
  /// \return false if `limit` passed first, on the injected clock
  bool drain(std::shared_ptr<Outbox> outbox, std::chrono::milliseconds limit) IOTCLOUD_EXCLUDES(mutex);
  std::size_t pending(const Outbox& outbox) const IOTCLOUD_EXCLUDES(mutex);
  /// When the publisher's oldest message that waits or is under way was accepted.
  std::optional<Instant> oldest(const Outbox& outbox) const IOTCLOUD_EXCLUDES(mutex);

  // For the transport.

  /// Exclusive use of the connection for sending, as long as the object lives: no other thread sends meanwhile, even
  /// while the mutex is released. A thread that finds the connection taken leaves its message to the thread that has
  /// it. Construct and destroy it with the mutex held.
  class Turn {
   public:
    /// Waits until no other thread has the Turn.
    explicit Turn(PublishCore& core) IOTCLOUD_REQUIRES(core.mutex);
    ~Turn() IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS;  // the core's mutex is held, see above
    Turn(const Turn&) = delete;
    Turn& operator=(const Turn&) = delete;

   private:
    PublishCore& core_;
  };
  bool turn_taken() const IOTCLOUD_REQUIRES(mutex) { return turn_taken_; }
  /// How many Turns there have been; identifies the current one.
  std::uint64_t turns() const IOTCLOUD_REQUIRES(mutex) { return turns_; }

  /// Sends waiting messages, at most `most` from each lane, as long as the transport has room.
  void send_waiting(const Turn& turn, std::size_t most) IOTCLOUD_REQUIRES(mutex);
  /// Whether some lane has a message whose publisher may send it now.
  bool has_waiting() const IOTCLOUD_REQUIRES(mutex);
  /// The lanes that have such a message.
  const std::deque<PublishLane*>& waiting_lanes() const IOTCLOUD_REQUIRES(mutex) { return lanes_; }
  /// Messages without an answer, in the order in which they were sent.
  const std::list<UnderWay>& under_way() const IOTCLOUD_REQUIRES(mutex) { return under_way_; }
  const std::vector<std::shared_ptr<Outbox>>& outboxes() const IOTCLOUD_REQUIRES(mutex) { return outboxes_; }

  /// The transport can now send to this publisher's topic (what was missing is declared).
  void open(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_REQUIRES(mutex);
  /// Puts a publisher into its lane if it has a message that may be sent.
  void make_runnable(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_REQUIRES(mutex);

  // The outcome of a message under way. Each of these functions ends its UnderWay.
  void confirmed(UnderWay& message) IOTCLOUD_REQUIRES(mutex);
  /// The server will never accept the message.
  void refused(UnderWay& message, const std::string& why) IOTCLOUD_REQUIRES(mutex);
  /// The server refused the message for a reason that may pass: it is tried again after a pause, before later ones.
  void refused_for_now(UnderWay& message, const std::string& why) IOTCLOUD_REQUIRES(mutex);
  /// The server returned the message because nobody reads the topic: it is tried again after a pause, before later
  /// ones.
  void returned(UnderWay& message) IOTCLOUD_REQUIRES(mutex);
  /// The server could not store the message: it is tried again after a pause, marked as sent before.
  void put_off(UnderWay& message) IOTCLOUD_REQUIRES(mutex);
  /// The transport could not send the message after all: it waits again, before later ones.
  void lost(UnderWay& message) IOTCLOUD_REQUIRES(mutex);
  /// The message failed for a reason that may pass: it waits again. Later messages of its publisher that are under way
  /// must be answered first, so that nothing overtakes it.
  void failed(UnderWay& message) IOTCLOUD_REQUIRES(mutex);
  /// Nobody reads this publisher's topic: its next message is sent only after a pause.
  void nobody_reads(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_REQUIRES(mutex);
  /// The connection is lost, and with it all declarations: unanswered messages wait and are sent again, marked. Not to
  /// be called while another thread has the Turn. \param one_by_one send each of them alone, because one of them made
  /// the server close the connection or its channel; pauses before a retry go on
  void connection_lost(bool one_by_one) IOTCLOUD_REQUIRES(mutex);
  /// The message under way if there is exactly one and its publisher is not closed; otherwise nullptr. A refusal that
  /// names no message is then about this one.
  UnderWay* the_only_one() IOTCLOUD_REQUIRES(mutex);

  /// Handles the publishers' timers that are due: drops expired messages, tries messages again. \return whether any was
  /// due
  bool fire_timers() IOTCLOUD_REQUIRES(mutex);
  /// When fire_timers() has something to do; Instant::max(): no timer is set.
  Instant next_timer() const IOTCLOUD_REQUIRES(mutex) { return timers_.next(); }
  /// Whether some publisher has something to report.
  bool report_due() const IOTCLOUD_REQUIRES(mutex) { return !to_report_.empty(); }
  /// Calls the callbacks of all publishers that have something to report, with the mutex released. Callbacks of one
  /// publisher never overlap.
  void report() IOTCLOUD_REQUIRES(mutex);

 private:
  Published refuse(const std::shared_ptr<Outbox>& outbox, Message message, Instant now, const char* why)
      IOTCLOUD_REQUIRES(mutex);
  /// \return whether the transport has the message; otherwise it is still in `accepted`
  bool send_alone(const std::shared_ptr<Outbox>& outbox, AcceptedMessage& accepted) IOTCLOUD_REQUIRES(mutex);
  void send_lane(PublishLane& lane, std::size_t most) IOTCLOUD_REQUIRES(mutex);
  UnderWay& begin(std::shared_ptr<Outbox> outbox, AcceptedMessage&& accepted) IOTCLOUD_REQUIRES(mutex);
  /// Ends a message under way. \return its publisher, and its message in `accepted`
  std::shared_ptr<Outbox> end(UnderWay& message, AcceptedMessage& accepted) IOTCLOUD_REQUIRES(mutex);
  /// The common part of all answers: ends the message, and calls `tell` for its publisher unless that is closed.
  template <typename Tell>
  void answered(UnderWay& message, Tell tell) IOTCLOUD_REQUIRES(mutex);
  void list_for_report(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_REQUIRES(mutex);
  /// To be called after every change of a publisher's messages. Wakes the transport's thread if it would sleep too
  /// long.
  void note(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_REQUIRES(mutex);
  void changed(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_REQUIRES(mutex);
  void report(const std::shared_ptr<Outbox>& outbox) IOTCLOUD_REQUIRES(mutex);
  void call_back(Outbox& outbox, const std::vector<Outbox::Event>& events, bool writable) IOTCLOUD_EXCLUDES(mutex);

  PublishTransport& transport_;
  Meters& meters_;
  const config::Clock& clock_;

  config::ConditionVariable changed_;  ///< notified when the Turn ends and when a callback has returned
  bool turn_taken_ IOTCLOUD_GUARDED_BY(mutex) = false;
  bool left_for_turn_ IOTCLOUD_GUARDED_BY(mutex) = false;  ///< a message waits for the thread that has the Turn
  std::uint64_t turns_ IOTCLOUD_GUARDED_BY(mutex) = 0;
  std::vector<std::shared_ptr<Outbox>> outboxes_ IOTCLOUD_GUARDED_BY(mutex);
  PublishLane lane_ IOTCLOUD_GUARDED_BY(mutex);  ///< the lane of publishers to which the transport assigns none
  std::deque<PublishLane*> lanes_ IOTCLOUD_GUARDED_BY(mutex);
  std::list<UnderWay> under_way_ IOTCLOUD_GUARDED_BY(mutex);
  std::list<UnderWay> spare_ IOTCLOUD_GUARDED_BY(mutex);  ///< unused nodes, so that a message needs no allocation
  /// How many messages must still be sent alone, because one of them made the server close a connection or channel.
  std::size_t one_by_one_ IOTCLOUD_GUARDED_BY(mutex) = 0;
  OutboxTimers timers_ IOTCLOUD_GUARDED_BY(mutex);
  std::deque<std::shared_ptr<Outbox>> to_report_ IOTCLOUD_GUARDED_BY(mutex);
};

/// A publisher of a PublishCore's connection.
class CorePublisher final : public Publisher {
 public:
  /// \param core outlives the publisher
  CorePublisher(PublishCore& core, const Topic& topic, const PublisherOptions& options)
      : core_(core), outbox_(core.add(topic, options)) {}
  ~CorePublisher() override { core_.remove(outbox_); }
  CorePublisher(const CorePublisher&) = delete;
  CorePublisher& operator=(const CorePublisher&) = delete;
  Published publish(Message message) override { return core_.publish(outbox_, std::move(message), {}); }
  Published publish_again(Message message, const Past& past) override {
    return core_.publish(outbox_, std::move(message), past);
  }
  bool drain(std::chrono::milliseconds limit) override { return core_.drain(outbox_, limit); }
  std::size_t pending() const override { return core_.pending(*outbox_); }
  std::optional<Instant> oldest() const override { return core_.oldest(*outbox_); }

 private:
  PublishCore& core_;
  const std::shared_ptr<Outbox> outbox_;
};

}  // namespace iotcloud::brokers::client
