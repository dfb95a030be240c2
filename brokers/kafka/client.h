#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include <librdkafka/rdkafka.h>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::kafka {

/// A client cannot be made or a request failed; the text is for the log. Producer and ConsumerGroup catch it; users
/// never see it.
class ClientError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// BrokerOptions for Kafka, with Kafka's own properties parsed.
struct KafkaOptions {
  BrokerOptions broker;
  std::vector<BrokerUrl> urls;
  bool native_headers = false;  ///< property `envelope`: `headers` rather than `thrift`
  /// The properties `partitions` and `replication` are for topics that this client makes. -1: the server chooses the
  /// numbers, as it does for topics that it makes itself at their first use; so a topic is the same whoever makes it.
  int partitions = -1;
  int replication = -1;
  int max_message_bytes = 16'777'216;  ///< property `max_message_bytes`: the largest record, envelope included
};

/// \throws config::Error for an unknown property or a bad value.
KafkaOptions kafka_options(const BrokerOptions& options, const std::vector<BrokerUrl>& urls);

/// Whether the connections are TLS ones.
bool is_secured(const KafkaOptions& options);

/// Settings by librdkafka's names.
using Settings = std::map<std::string, std::string>;

/// How often a producer or group without a connection checks for one, because the library does not report it.
inline constexpr std::chrono::milliseconds look_again{50};
/// How long a producer or group waits for another connection after one failed, unless the library reports that it was
/// the last.
inline constexpr std::chrono::milliseconds longest_doubt{1000};

/// One client of librdkafka: a producer, or a consumer in a group. Every received message holds a reference to its
/// client, because messages must be destroyed before it. So the destructor may run on any thread. It waits for the
/// library's threads, but not longer than two seconds; afterwards they end in the background.
class KafkaClient {
 public:
  /// Connects in the background. \param events which events to deliver (RD_KAFKA_EVENT_*).
  /// \throws ClientError; config::Error if the password cannot be read.
  KafkaClient(rd_kafka_type_t type, const KafkaOptions& options, const Settings& settings, int events);
  ~KafkaClient();
  KafkaClient(const KafkaClient&) = delete;
  KafkaClient& operator=(const KafkaClient&) = delete;

  rd_kafka_t* get() const { return handle_; }
  /// Whether there is an authenticated connection to some server. Does not wait; begins to connect if there is none.
  bool connected() const;
  /// How many partitions of this topic a server knows; 0: none, perhaps not yet, just after the topic was made. Waits
  /// for the answer.
  int partitions(const std::string& topic, std::chrono::milliseconds limit) const;
  /// Reads user and password again for the next log-in, unless it did so a moment before `now`. Not thread safe.
  void refresh_credentials(const KafkaOptions& options, config::Clock::Instant now);

 private:
  config::Clock::Instant refreshed_{};
  rd_kafka_t* handle_ = nullptr;
};

struct QueueDestroyer {
  void operator()(rd_kafka_queue_t* queue) const { rd_kafka_queue_destroy(queue); }
};
using Queue = std::unique_ptr<rd_kafka_queue_t, QueueDestroyer>;

struct EventDestroyer {
  void operator()(rd_kafka_event_t* event) const { rd_kafka_event_destroy(event); }
};
using Event = std::unique_ptr<rd_kafka_event_t, EventDestroyer>;

struct PartitionListDestroyer {
  void operator()(rd_kafka_topic_partition_list_t* list) const { rd_kafka_topic_partition_list_destroy(list); }
};
using PartitionList = std::unique_ptr<rd_kafka_topic_partition_list_t, PartitionListDestroyer>;
inline std::span<const rd_kafka_topic_partition_t> entries_of(const rd_kafka_topic_partition_list_t& list) {
  return {list.elems, static_cast<std::size_t>(list.cnt)};
}

/// Whether this error means that servers are unreachable, not that they refused a request.
bool is_about_connection(rd_kafka_resp_err_t error);
/// The text of an error event without changing parts (this attempt's time, the number of earlier failures), so that
/// repetitions are equal.
std::string lasting_words(rd_kafka_event_t* event);

/// Asks the servers to make topics; the answer comes to `queue` as RD_KAFKA_EVENT_CREATETOPICS_RESULT.
void request_topics(const KafkaClient& client, rd_kafka_queue_t* queue, const std::vector<std::string>& names,
                    const KafkaOptions& options);

struct MadeTopic {
  std::string name;
  bool there = false;     ///< the topic exists now; false: ask again later
  std::string complaint;  ///< empty, or why the topic was not made
};
/// \param asked the names in the request; if the whole request failed, all of them failed.
std::vector<MadeTopic> made_topics(rd_kafka_event_t* event, const std::vector<std::string>& asked);

}  // namespace iotcloud::brokers::kafka
