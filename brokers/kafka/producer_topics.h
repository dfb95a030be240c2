#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <librdkafka/rdkafka.h>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/publish_transport.h"
#include "iotcloud/brokers/kafka/client.h"
#include "iotcloud/brokers/kafka/first_messages.h"
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::kafka {

/// Decides when the library gets more messages of one topic.
///
/// Once five messages of a partition are under way, an idempotent producer of librdkafka 2.0 (and later) sends only one
/// request of that partition at a time (librdkafka issue 4989: it counts messages instead of requests). It queues
/// further messages, and its thread polls without sleeping until the answer comes, because with a linger of 0 they are
/// due. So the library gets single messages only while fewer than five are under way. Otherwise messages wait here, and
/// go to the library together when all earlier ones are answered (a *wave*). A wave becomes one request for each
/// partition, provided that all its messages are handed over before the library's thread wakes up. A partition with
/// messages still under way would keep that thread awake; it would cut the wave into several requests, keep the rest,
/// and go on polling. If the server of one partition does not answer, the other partitions of the topic wait at most 50
/// ms for it.
///
/// A server judges a request as a whole: it refuses all messages of one that is larger than the topic takes, or that
/// has a bad message in it. Messages that were refused in company are sent again, each alone; only what was alone in
/// its request is refused for good. If the server takes each of them then, later waves are half as large.
struct TopicLane final : client::PublishLane {
  using Instant = config::Clock::Instant;

  /// Whether a single message may go now.
  bool takes_one() const { return under_way < std::min(most_singles, most_in_wave()); }
  bool takes_wave(Instant now) const { return under_way == 0 || now >= opens_at(); }
  /// The time from which a wave may go even if not all messages are answered.
  Instant opens_at() const {
    return std::max(handed_over_at + (one_by_one > 0 ? longest_wait_alone : longest_wait),
                    first_messages.waits_until());
  }
  /// The most messages in one wave.
  std::size_t most_in_wave() const {
    if (one_by_one > 0) return 1;
    return std::min(most_taken, answered_slowly ? most_in_slow_wave : most_in_quick_wave);
  }
  /// The library gets a message with this key.
  void sent(std::string_view key, const config::Clock& clock) {
    if (under_way++ > 0) in_company = true;
    first_messages.sent(key, clock);
  }
  /// A message with this key was answered.
  void answered(std::string_view key, bool stored, Instant now) {
    first_messages.answered(key, stored);
    forgotten();
    if (under_way == 0) answered_slowly = now - handed_over_at > slow_answer;
  }
  /// A message will not be answered any more.
  void forgotten() {
    if (--under_way == 0) in_company = false;
  }
  /// A server refused a request with several messages, of which this is one.
  void refused_in_company() {
    if (one_by_one == refused_together) ++refused_together;
    ++one_by_one;
  }
  /// A message was sent alone, and the server has it or refused it for good.
  void settled_alone(bool stored) {
    if (one_by_one == 0) return;
    all_taken_alone = all_taken_alone && stored;
    if (--one_by_one > 0) return;
    if (all_taken_alone) most_taken = std::max<std::size_t>(refused_together / 2, 1);
    refused_together = 0;
    all_taken_alone = true;
  }

  /// The most payload bytes in one wave: below the library's batch.size (1 MB), so that it is one request.
  static constexpr std::size_t most_bytes_in_wave = 900'000;
  /// After this time the library gets the next wave although answers are missing.
  static constexpr std::chrono::milliseconds longest_wait{50};
  /// The same while messages are sent one by one.
  static constexpr std::chrono::milliseconds longest_wait_alone{1000};

  bool made = false;                        ///< the request to make the topic succeeded
  std::shared_ptr<rd_kafka_topic_t> topic;  ///< null: no server is known to have the topic yet
  std::string complaint;                    ///< the last logged complaint
  FirstMessages first_messages;             ///< begun when the topic was found
  std::size_t under_way = 0;                ///< messages that the library has
  bool in_company = false;                  ///< since nothing was under way, two messages were so at once
  std::size_t one_by_one = 0;               ///< how many messages are still to be sent alone
  Instant handed_over_at{};                 ///< when the library last got a message of the topic
  bool answered_slowly = false;             ///< the last messages took longer than slow_answer until all were answered

 private:
  static constexpr std::size_t most_singles = 5;  // RD_KAFKA_IDEMP_MAX_INFLIGHT
  static constexpr std::size_t most_in_quick_wave = 1024;
  static constexpr std::size_t most_in_slow_wave = 4096;
  std::size_t most_taken = most_in_slow_wave;  ///< the most messages that a server may take in one request
  std::size_t refused_together = 0;            ///< the size of the wave for which messages are sent one by one
  bool all_taken_alone = true;                 ///< none of its messages was refused when it was sent alone
  static constexpr std::chrono::milliseconds slow_answer{2};
};

/// The topics to which a producer's publishers send: asks the servers to make them, and knows which exist. Not thread
/// safe.
class ProducerTopics {
 public:
  using Instant = config::Clock::Instant;

  /// The lane of the topic of that name; its address does not change.
  TopicLane& lane(const std::string& name) { return lanes_[name]; }
  /// Asks the servers to make the topics that are not made yet, unless a request is under way or it is too early.
  void ask(const KafkaClient& client, rd_kafka_queue_t* events, const KafkaOptions& options, Instant now);
  void on_answer(rd_kafka_event_t* event, Instant now);
  /// The topics that were made but that no server lists yet, which takes a moment.
  std::vector<std::string> unseen(Instant now) const;
  /// Reports whether one of them was found, and how many partitions it has.
  void not_there(const std::string& name, Instant now);
  void there(const std::string& name, int partitions, const KafkaClient& client);
  /// The servers report that they do not know the topic.
  static void gone(TopicLane& lane);
  /// When ask() or unseen() has something to do; Instant::max(): not before an answer comes.
  Instant next_look() const;
  /// Forgets which topics exist, because the client has ended.
  void forget();

 private:
  struct TopicDestroyer {
    void operator()(rd_kafka_topic_t* topic) const { rd_kafka_topic_destroy(topic); }
  };

  std::map<std::string, TopicLane> lanes_;
  std::vector<std::string> asked_;  ///< topics of the one request that is under way
  Instant ask_at_{};
  client::Backoff backoff_{std::chrono::milliseconds(20), std::chrono::milliseconds(2000)};
};

}  // namespace iotcloud::brokers::kafka
