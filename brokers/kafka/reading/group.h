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
#include "iotcloud/brokers/kafka/reading/reader.h"

namespace iotcloud::brokers::kafka {

using client::Backoff;
using client::ConnectionLog;
using Instant = config::Clock::Instant;

/// One consumer of librdkafka: this process as a member of one group, for all topics that it reads in it. Takes part in
/// the group's rebalances (cooperative: what stays is read on), gives partitions to the reader, commits. Not thread
/// safe: the thread of the groups calls it, so that no handler can hold up the group.
class Group {
 public:
  /// \param wake signalled when there is something to serve
  Group(const KafkaOptions& options, std::shared_ptr<Reader> reader, std::shared_ptr<Member> member,
        const config::Clock& clock, ConnectionLog& log, client::WakeEvent& wake);
  ~Group();
  Group(const Group&) = delete;
  Group& operator=(const Group&) = delete;

  const std::shared_ptr<Member>& member() const { return member_; }
  /// Does what is due; waits for servers' answers, some seconds at most. \return how long nothing is due
  std::chrono::milliseconds serve();
  /// Begins to leave the group, after a last commit; go on with serve() until closed(), which takes some seconds at
  /// most.
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
  std::set<std::string> subscription() const;  ///< what the library says
  void join_for_unread(Instant now);
  std::set<std::string> unread() const;  ///< topics of which this member has no partition
  void stop_reading(const std::set<PartitionKey>& keys);
  rd_kafka_resp_err_t commit_unsaved(const std::set<PartitionKey>& keys);
  void warn_of_unsaved(rd_kafka_resp_err_t error) const;
  void commit_settled(Instant now);
  std::chrono::milliseconds serve_closing(Instant now);
  void leave_group();
  bool cooperative() const;

  const KafkaOptions& options_;
  const std::shared_ptr<Reader> reader_;
  const std::shared_ptr<Member> member_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  client::WakeEvent& wake_;

  std::chrono::milliseconds session_;
  std::shared_ptr<Client> client_;
  Queue events_;
  bool connected_ = false;
  Instant doubted_at_{};  ///< some connection failed: another one is looked for since then; zero: none did
  bool broken_ = false;   ///< the client is of no use any more
  bool closing_ = false;
  std::string last_error_;
  std::set<PartitionKey> assigned_;
  std::map<PartitionKey, Committed> unsaved_;  ///< to commit, of assigned partitions that are not read any more
  std::set<std::string> made_;                 ///< topics that were asked for with success
  std::set<std::string> there_;                ///< those of them that servers tell of
  std::set<std::string> subscribed_;           ///< what the group was told
  bool subscription_is_taken_ = false;         ///< and what the library goes by
  std::set<std::string> forgotten_;            ///< topics without a partition here: to leave, and to join for again
  std::vector<std::string> asked_;             ///< topics of the one request that is under way
  std::set<std::string> complaints_;           ///< those that were logged
  Instant ask_topics_at_{};
  Instant commit_at_{};
  Instant start_at_{};
  Instant join_again_at_{};  ///< for topics of which the last assignment brought nothing; zero: there are none
  bool leaving_ = false;     ///< closing, and the last commit was made or given up
  Instant close_by_{};       ///< closing: until then the last commit may take, later how long leaving may
  Backoff topic_backoff_{std::chrono::milliseconds(20), std::chrono::milliseconds(2000)};
  Backoff join_backoff_{std::chrono::milliseconds(1000), std::chrono::milliseconds(300'000)};
};

}  // namespace iotcloud::brokers::kafka
