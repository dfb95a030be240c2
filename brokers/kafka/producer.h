#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/publish_core.h"
#include "iotcloud/brokers/client/wake_event.h"
#include "iotcloud/brokers/kafka/client.h"
#include "iotcloud/brokers/kafka/gathering.h"
#include "iotcloud/brokers/kafka/producer_topics.h"
#include "iotcloud/brokers/kafka/renewal.h"
#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers::kafka {

using client::Backoff;
using client::ConnectionLog;
using client::Instant;
using client::Outbox;
using client::PublishCore;
using client::UnderWay;
using client::WakeEvent;

/// One idempotent producer of librdkafka for many publishers, and the thread that serves it: the transport of a
/// PublishCore.
///
/// While a server is connected, publish() gives the message to the library on the caller's thread (that never blocks);
/// otherwise messages wait in their Outbox, under the channel's own policy. Messages that the library has when the
/// connection breaks stay there: the library sends them again, without duplicates and in order.
///
/// Of one topic the library gets only what it can send at once: single messages, or a wave of them (see TopicLane). A
/// request costs client and server many times as much as a message in it. So messages that a handler's thread publishes
/// go in one wave, when that thread has handled the records that came together. A handler may run long, or wait for an
/// outcome, so a message is kept back only if the producer's thread will check soon anyway: when an answer is to come,
/// or when messages were gathered a moment ago.
class Producer final : client::PublishTransport {
 public:
  Producer(KafkaOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log);
  ~Producer() override;
  Producer(const Producer&) = delete;
  Producer& operator=(const Producer&) = delete;

  /// The core, to which publishers are added.
  PublishCore& core() { return core_; }
  ConnectionState state() const;

 private:
  /// For `gathers_again` after messages were gathered, the producer's thread sleeps at most `watch_period`.
  static constexpr std::chrono::milliseconds gathers_again{100}, watch_period{2};

  /// The two clocks, read once for many messages.
  struct Now {
    Instant instant;
    std::int64_t wall_ms;
  };
  /// Messages that the library did not take, with its error.
  using Failed = std::vector<std::pair<UnderWay*, rd_kafka_resp_err_t>>;

  // The PublishTransport.
  void added(const std::shared_ptr<Outbox>& outbox) override IOTCLOUD_REQUIRES(core_.mutex);
  Room room(const std::shared_ptr<Outbox>& outbox, const Message& next, bool alone) override
      IOTCLOUD_REQUIRES(core_.mutex);
  void send(UnderWay& message) override IOTCLOUD_REQUIRES(core_.mutex);
  void send_alone(UnderWay& message) override IOTCLOUD_REQUIRES(core_.mutex);
  void send_gathered() override IOTCLOUD_REQUIRES(core_.mutex);
  void broke(const char* why) noexcept override IOTCLOUD_REQUIRES(core_.mutex);
  void left_waiting(const std::shared_ptr<Outbox>& outbox, Instant now) override IOTCLOUD_REQUIRES(core_.mutex);
  void wake() noexcept override IOTCLOUD_REQUIRES(core_.mutex);

  // Run on the producer's thread.
  void run();
  void start_client() IOTCLOUD_REQUIRES(core_.mutex);
  void end_client(const std::string& reason) IOTCLOUD_REQUIRES(core_.mutex);
  void look_for_servers() IOTCLOUD_REQUIRES(core_.mutex);
  void look_for_renewal() IOTCLOUD_REQUIRES(core_.mutex);
  void look_for_overtaking() IOTCLOUD_REQUIRES(core_.mutex);
  void look_for_void() IOTCLOUD_REQUIRES(core_.mutex);
  void look_for_topics() IOTCLOUD_REQUIRES(core_.mutex);
  void serve_events() IOTCLOUD_REQUIRES(core_.mutex);
  void on_event(rd_kafka_event_t* event) IOTCLOUD_REQUIRES(core_.mutex);
  void on_error(rd_kafka_event_t* event) IOTCLOUD_REQUIRES(core_.mutex);
  void lose_connection() IOTCLOUD_REQUIRES(core_.mutex);
  std::chrono::milliseconds time_to_sleep() IOTCLOUD_REQUIRES(core_.mutex);

  /// Handles the library's report of a message's outcome. \param in_company other messages may have been in its request
  void settle(UnderWay& message, rd_kafka_resp_err_t error, bool in_company = false) IOTCLOUD_REQUIRES(core_.mutex);
  bool may_send() const IOTCLOUD_REQUIRES(core_.mutex);
  void send_waiting() IOTCLOUD_REQUIRES(core_.mutex);
  void end_gathering() IOTCLOUD_EXCLUDES(core_.mutex);
  /// The calling thread's gathering if a message that it publishes now may be kept back; otherwise null.
  Gathering* gathering_for(const Outbox& outbox, const TopicLane& lane) const IOTCLOUD_REQUIRES(core_.mutex);
  void prepare(UnderWay& message) const;
  rd_kafka_resp_err_t hand_over(UnderWay& message, rd_kafka_t* producer, rd_kafka_topic_t* topic, const Now& now) const;
  Failed hand_over_all(const std::vector<UnderWay*>& wave, rd_kafka_t* producer, rd_kafka_topic_t* topic,
                       const Now& now) const;

  const KafkaOptions options_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  WakeEvent wake_event_;
  PublishCore core_;
  Renewal renewal_;  ///< only the producer's thread uses it

  /// Replaced by the producer's thread, with the core's Turn.
  std::shared_ptr<KafkaClient> client_ IOTCLOUD_GUARDED_BY(core_.mutex);
  Queue events_ IOTCLOUD_GUARDED_BY(core_.mutex);
  ProducerTopics topics_ IOTCLOUD_GUARDED_BY(core_.mutex);
  std::vector<UnderWay*> wave_ IOTCLOUD_GUARDED_BY(core_.mutex);  ///< the gathered messages, all of one topic
  std::size_t wave_bytes_ IOTCLOUD_GUARDED_BY(core_.mutex) = 0;
  bool closing_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  bool connected_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  /// When a connection failed; since then the producer looks for another one. Zero: none failed.
  Instant doubted_at_ IOTCLOUD_GUARDED_BY(core_.mutex){};
  bool broken_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;  ///< the library reported a fatal error of the client
  /// The library's queue is full until the next delivery report.
  bool full_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  bool sleeping_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  Instant last_gathering_ IOTCLOUD_GUARDED_BY(core_.mutex){};
  bool watching_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;  ///< the producer's thread checks again within watch_period
  /// After an error that may pass nothing is sent before this time. Zero: no such pause.
  Instant send_again_at_ IOTCLOUD_GUARDED_BY(core_.mutex){};
  Backoff send_backoff_ IOTCLOUD_GUARDED_BY(core_.mutex){std::chrono::milliseconds(20),
                                                         std::chrono::milliseconds(1000)};
  std::string last_error_ IOTCLOUD_GUARDED_BY(core_.mutex);  ///< the library's last error about its connections
  /// When the next client may be started, after one that could not be made or could not go on.
  Instant next_attempt_ IOTCLOUD_GUARDED_BY(core_.mutex){};
  Backoff client_backoff_ IOTCLOUD_GUARDED_BY(core_.mutex){std::chrono::milliseconds(20),
                                                           std::chrono::milliseconds(5000)};

  /// Topics and drivers of messages that were refused in company; see look_for_overtaking().
  std::set<std::pair<const TopicLane*, std::string>> set_back_ IOTCLOUD_GUARDED_BY(core_.mutex);

  Instant next_void_look_ IOTCLOUD_GUARDED_BY(core_.mutex){};  ///< see look_for_void()

  /// A client with renewed files waits until the present one's messages are answered, but not longer. Zero: none waits.
  Instant renew_by_ IOTCLOUD_GUARDED_BY(core_.mutex){};

  std::string complaint_ IOTCLOUD_GUARDED_BY(core_.mutex);  ///< why the last client could not go on, if it was logged
  const std::shared_ptr<Gathering::Target> gathering_target_;
  std::thread thread_;
};

}  // namespace iotcloud::brokers::kafka
