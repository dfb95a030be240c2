#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/connection_log.h"
#include "iotcloud/brokers/client/wake_event.h"
#include "iotcloud/brokers/kafka/client.h"
#include "iotcloud/brokers/kafka/reading/partition_reader.h"
#include "iotcloud/brokers/kafka/renewal.h"

namespace iotcloud::brokers::kafka {

using client::Backoff;
using client::ConnectionLog;
using Instant = config::Clock::Instant;

/// One consumer of librdkafka: this process as a member of one group, for all topics that it reads in the group. Takes
/// part in the group's rebalances (cooperative or eager, see assignment.h), gives assigned partitions to the reader,
/// and commits. Not thread safe: only the groups' thread calls it, so that no
/// handler can hold up the group.
class ConsumerGroup {
 public:
  /// \param wake is signalled when there is an event to serve
  ConsumerGroup(const KafkaOptions& options, std::shared_ptr<PartitionReader> reader,
                std::shared_ptr<GroupMember> member, const config::Clock& clock, ConnectionLog& log,
                client::WakeEvent& wake);
  ~ConsumerGroup();
  ConsumerGroup(const ConsumerGroup&) = delete;
  ConsumerGroup& operator=(const ConsumerGroup&) = delete;

  const std::shared_ptr<GroupMember>& member() const { return member_; }
  /// Does what is due; waits for servers' answers, at most some seconds. \return how long it takes until something is
  /// due
  std::chrono::milliseconds serve();
  /// Begins to leave the group, after a last commit. Call serve() until closed(), which takes at most some seconds.
  void close() { closing_ = true; }
  bool closed() const;

 private:
  std::chrono::milliseconds time_to_sleep(Instant now) const;
  void start_client();
  void end_client();
  void watch(const Queue& queue) const;
  void look_for_servers();
  void on_event(rd_kafka_event_t* event);
  void on_error(rd_kafka_event_t* event);
  void on_assign(const rd_kafka_topic_partition_list_t& partitions);
  void on_revoke(const rd_kafka_topic_partition_list_t& partitions);
  void on_topics(rd_kafka_event_t* event);
  void follow_subscriptions(Instant now);
  void tell_subscription(std::set<std::string> topics);
  std::set<std::string> subscription() const;  ///< the library's present subscription
  void join_for_unread(Instant now);
  std::set<std::string> unread() const;  ///< topics without a partition for this member
  void stop_reading(const std::set<PartitionKey>& keys);
  rd_kafka_resp_err_t commit_unsaved(const std::set<PartitionKey>& keys);
  void warn_of_unsaved(rd_kafka_resp_err_t error) const;
  void commit_settled(Instant now);
  std::chrono::milliseconds serve_closing(Instant now);
  void leave_group();
  /// Whether the present client is to leave its group.
  bool ending() const { return closing_ || renewing_; }
  PartitionList wanted(const rd_kafka_topic_partition_list_t& partitions) const;

  const KafkaOptions& options_;
  const std::shared_ptr<PartitionReader> reader_;
  const std::shared_ptr<GroupMember> member_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  client::WakeEvent& wake_;

  std::chrono::milliseconds session_;
  Renewal renewal_;
  std::shared_ptr<KafkaClient> client_;
  Queue events_;
  bool connected_ = false;
  Instant doubted_at_{};  ///< when a connection failed; since then the group looks for a server. Zero: none failed
  bool broken_ = false;   ///< the client cannot be used any more
  bool closing_ = false;
  bool renewing_ = false;  ///< leaving the group, for a client with renewed files to join it
  std::string last_error_;
  std::set<PartitionKey> assigned_;
  std::map<PartitionKey, Committed> unsaved_;  ///< to commit, for assigned partitions that are not read any more
  std::set<std::string> made_;                 ///< topics whose creation request succeeded
  std::set<std::string> there_;                ///< topics of made_ that the servers list
  std::set<std::string> subscribed_;           ///< the topics of the last subscription request
  bool subscription_is_taken_ = false;         ///< the library has taken that subscription over
  std::set<std::string> forgotten_;            ///< topics without a partition here: to leave and to join again
  std::vector<std::string> asked_;             ///< topics of the request that is under way
  std::set<std::string> complaints_;           ///< complaints that the log has already
  Instant ask_topics_at_{};
  Instant commit_at_{};
  Instant start_at_{};
  /// When to join again for topics of which this member got no partition; zero: there are none.
  Instant join_again_at_{};
  bool leaving_ = false;  ///< ending, and the last commit was made or given up
  Instant close_by_{};    ///< ending: the limit for the last commit, later the limit for leaving
  Backoff topic_backoff_{std::chrono::milliseconds(20), std::chrono::milliseconds(2000)};
  Backoff join_backoff_{std::chrono::milliseconds(1000), std::chrono::milliseconds(300'000)};
};

}  // namespace iotcloud::brokers::kafka
