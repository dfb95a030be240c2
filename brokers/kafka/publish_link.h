#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/outbox_timers.h"
#include "iotcloud/brokers/client/outcome_reporter.h"
#include "iotcloud/brokers/client/wake_event.h"
#include "iotcloud/brokers/envelope.h"
#include "iotcloud/brokers/kafka/burst.h"
#include "iotcloud/brokers/kafka/client.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::kafka {

using client::Backoff;
using client::ConnectionLog;
using client::Instant;
using client::Outbox;
using client::Outgoing;
using client::WakeEvent;

/// One producer of librdkafka, idempotent, for many publishers, and the one thread that serves it.
///
/// While a server is there, publish() gives the message to the library on the caller's thread (that never blocks);
/// while none is, messages wait in their Outbox, under the channel's own policy. What the library has when the
/// connection breaks stays there: it sends it again itself, without duplicates and in order.
///
/// The library gets of one topic what it can send at once, and no more: single messages, or one request's worth of them
/// (a wave), while few are under way. What it could not send would make its thread spin, see publish_link_waves.cc;
/// meanwhile messages wait here and the next wave is larger. What a thread publishes in a Burst goes as one wave.
class PublishLink {
 public:
  PublishLink(KafkaOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log);
  ~PublishLink();
  PublishLink(const PublishLink&) = delete;
  PublishLink& operator=(const PublishLink&) = delete;

  std::shared_ptr<Outbox> add(const Topic& topic, const PublisherOptions& options);
  /// Closes the publisher: reports what has no outcome as unknown, waits for callbacks that run.
  void remove(const std::shared_ptr<Outbox>& outbox);
  PublishStatus publish(const std::shared_ptr<Outbox>& outbox, Message message, const Past& past = {});
  bool drain(const std::shared_ptr<Outbox>& outbox, std::chrono::milliseconds limit);
  std::size_t pending(const Outbox& outbox) const;
  ConnectionState state() const;

 private:
  /// After so long without all answers the library gets more of a topic.
  static constexpr std::chrono::milliseconds longest_wait{50};
  /// So long after a burst the link's thread sleeps this long at most.
  static constexpr std::chrono::milliseconds bursts_again{100}, watch_period{2};

  using Lock = std::unique_lock<std::mutex>;
  struct TopicDestroyer {
    void operator()(rd_kafka_topic_t* topic) const { rd_kafka_topic_destroy(topic); }
  };
  /// One topic.
  struct Route {
    bool made = false;                        ///< it was asked for with success
    std::shared_ptr<rd_kafka_topic_t> topic;  ///< null: not known to be there yet
    std::string complaint;                    ///< the last that was logged
    std::size_t under_way = 0;                ///< messages that the library has
    Instant handed_over_at{};                 ///< when it got something the last time
    bool answered_slowly = false;             ///< then it was long before all was answered
    std::deque<std::shared_ptr<Outbox>> runnable;
    bool in_runnable = false;  ///< stands in runnable_
    bool in_wave = false;      ///< the link's thread hands a wave over
  };
  /// Read once for many messages.
  struct Now {
    Instant instant;
    std::int64_t wall_ms;
  };
  /// With the library until its delivery report.
  struct UnderWay {
    std::shared_ptr<Outbox> outbox;
    Route* route;
    Outgoing outgoing;
    EnvelopeBytes envelope;
    std::list<UnderWay>::iterator self;
  };

  void run();
  void start_client();
  void end_client(const std::string& reason);
  void look_for_servers();
  void serve_events(Lock& lock);
  void on_event(rd_kafka_event_t* event);
  void on_report(const rd_kafka_message_t& report);
  void on_error(rd_kafka_event_t* event);
  void on_topics(rd_kafka_event_t* event);
  void ask_for_topics(Instant now);
  void look_for_topics(Lock& lock);
  void settle(UnderWay& entry, rd_kafka_resp_err_t error);
  void lose_connection();

  UnderWay& add_under_way(const std::shared_ptr<Outbox>& outbox, Route& route, Outgoing outgoing);
  rd_kafka_resp_err_t hand_over(UnderWay& entry, rd_kafka_topic_t* topic, const Now& now) const;
  void prepare(UnderWay& entry) const;
  /// Whether the same message would meet this error again, whenever it is sent.
  static bool is_refusal(rd_kafka_resp_err_t error);
  bool takes_one(const Route& route) const;
  bool takes_wave(const Route& route, Instant now) const;
  static Instant opens_at(const Route& route);
  void answered(Route& route);
  void send_waiting(Lock& lock);
  void send_wave(Route& route, Lock& lock);
  Burst* burst_for(const Outbox& outbox, const Route& route) const;
  void send_burst();
  /// What the library did not take.
  using Failed = std::vector<std::pair<UnderWay*, rd_kafka_resp_err_t>>;
  Failed hand_over_all(const std::vector<UnderWay*>& wave, rd_kafka_topic_t* topic, const Now& now) const;
  std::vector<UnderWay*> take_wave(Route& route, Instant now);
  void make_runnable(const std::shared_ptr<Outbox>& outbox);
  void make_runnable(const std::shared_ptr<Outbox>& outbox, Route& route);
  bool may_send() const;
  std::chrono::milliseconds time_to_sleep(Instant now);
  /// After every change of a publisher's messages. \return whether the link's thread sleeps for too long now.
  bool note(const std::shared_ptr<Outbox>& outbox);
  void wake();

  const KafkaOptions options_;
  Meters& meters_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  WakeEvent wake_event_;
  const std::shared_ptr<Burst::Target> burst_target_{std::make_shared<Burst::Target>([this] { send_burst(); })};

  mutable std::mutex mutex_;
  std::condition_variable changed_;  ///< a callback ended
  // All below: guarded by mutex_. The client is replaced by the link's thread only, so that one may use it unlocked.
  client::OutcomeReporter reporter_{changed_, meters_};
  std::shared_ptr<Client> client_;
  Queue events_;
  std::map<std::string, Route> routes_;
  std::vector<std::string> asked_;  ///< topics of the one request that is under way
  std::list<UnderWay> under_way_;
  std::vector<std::shared_ptr<Outbox>> outboxes_;
  client::OutboxTimers timers_;
  std::deque<Route*> runnable_;  ///< those with something to send
  bool closing_ = false;
  bool connected_ = false;
  Instant doubted_at_{};  ///< some connection failed: another one is looked for since then; zero: none did
  bool broken_ = false;   ///< the client said that it is of no use any more
  bool full_ = false;     ///< the library takes no more before the next delivery report
  bool sleeping_ = false;
  Instant last_burst_{};
  bool watching_ = false;    ///< the link's thread looks again within watch_period
  Instant send_again_at_{};  ///< a message was turned down for a reason that may pass
  Instant ask_topics_at_{};
  Backoff send_backoff_{std::chrono::milliseconds(20), std::chrono::milliseconds(1000)};
  Backoff topic_backoff_{std::chrono::milliseconds(20), std::chrono::milliseconds(2000)};
  std::string last_error_;  ///< what the library said of its connections

  // The link's thread's.
  Instant next_attempt_{};
  Backoff backoff_{std::chrono::milliseconds(50), std::chrono::milliseconds(2000)};
  std::thread thread_;
};

}  // namespace iotcloud::brokers::kafka
