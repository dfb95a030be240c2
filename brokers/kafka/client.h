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

namespace iotcloud::brokers::kafka {

/// Why a client cannot be made or a request failed, in words for the log. Caught by the links, never seen by users.
class ClientError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// BrokerOptions, as far as Kafka is concerned, with its own properties read.
struct KafkaOptions {
  BrokerOptions broker;
  std::vector<BrokerUrl> urls;
  bool native_headers = false;         ///< property `envelope`: `headers` rather than `thrift`
  int partitions = 1;                  ///< property `partitions`: of topics that are made here
  int replication = 1;                 ///< property `replication`, likewise
  int max_message_bytes = 16'777'216;  ///< property `max_message_bytes`: largest record, envelope included
};

/// \throws config::Error for a property that is unknown or has no sensible value.
KafkaOptions kafka_options(const BrokerOptions& options, const std::vector<BrokerUrl>& urls);

/// Settings by librdkafka's names.
using Settings = std::map<std::string, std::string>;

/// Without a connection the links look again after so long: the library does not tell.
inline constexpr std::chrono::milliseconds look_again{50};
/// And when one failed of which it does not say that it was the last, another one is waited for so long.
inline constexpr std::chrono::milliseconds longest_doubt{1000};

/// One client of librdkafka: a producer, or a consumer in a group. Shared with every message that it received, because
/// those must die first; so its end, which waits for the library's threads, may come on any thread.
class Client {
 public:
  /// Connects in the background. `events`: which are to be events (RD_KAFKA_EVENT_*).
  /// \throws ClientError, config::Error when the password cannot be read.
  Client(rd_kafka_type_t type, const KafkaOptions& options, const Settings& settings, int events);
  ~Client();
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  rd_kafka_t* get() const { return handle_; }
  /// Whether there is a connection to some server, which has let us in. Does not wait; begins to connect if not.
  bool connected() const;
  /// Whether a server tells of this topic by now: after it was made that takes a moment. Waits for the answer.
  bool knows(const std::string& topic, std::chrono::milliseconds limit) const;
  /// Reads user and password anew, for the next attempt to log in, unless it did a moment ago. Not thread safe.
  void refresh_credentials(const KafkaOptions& options);

 private:
  std::chrono::steady_clock::time_point refreshed_{};
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

/// Whether this error is about reaching the servers, rather than about what was asked of them.
bool is_about_connection(rd_kafka_resp_err_t error);
/// What an error event says, without how long this attempt took and how often it failed before: each time the same
/// words.
std::string lasting_words(rd_kafka_event_t* event);

/// Asks the servers to make topics; the answer comes to `queue` as RD_KAFKA_EVENT_CREATETOPICS_RESULT.
void request_topics(const Client& client, rd_kafka_queue_t* queue, const std::vector<std::string>& names,
                    const KafkaOptions& options);

struct MadeTopic {
  std::string name;
  bool there = false;     ///< made now or before; false: ask again later
  std::string complaint;  ///< empty, or why it was not made
};
/// `asked`: the names of the request, which all failed when the request did.
std::vector<MadeTopic> made_topics(rd_kafka_event_t* event, const std::vector<std::string>& asked);

}  // namespace iotcloud::brokers::kafka
