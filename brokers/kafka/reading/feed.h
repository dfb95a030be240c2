#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "iotcloud/brokers/client/read_transport.h"
#include "iotcloud/brokers/kafka/client.h"
#include "iotcloud/brokers/kafka/reading/progress.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::kafka {

class PartitionReader;
struct GroupMember;

/// One subscription. Guarded by the reader's mutex, except for the constants.
struct TopicSubscriber : client::Subscriber {
  TopicSubscriber(std::shared_ptr<GroupMember> of, Topic to, SubscriptionOptions how, Handler what)
      : client::Subscriber(std::move(to), std::move(how), std::move(what)), member(std::move(of)) {}
  const std::shared_ptr<GroupMember> member;
  std::size_t unsettled = 0;  ///< deliveries of its feeds, waiting ones included
};

/// A topic and one of its partitions.
using PartitionKey = std::pair<std::string, std::int32_t>;

/// A base class, so that the window is constructed before the stream that refers to it.
struct FeedProgress {
  Progress progress;
};

/// One partition that the group assigned to this process. DeliveryStream::more is set from a signal of its queue until
/// the queue was found empty. Guarded by the reader's mutex, except for the constants.
class PartitionFeed final : public FeedProgress, public client::DeliveryStream {
 public:
  PartitionFeed(std::shared_ptr<PartitionReader> to, std::shared_ptr<GroupMember> of, std::shared_ptr<KafkaClient> from,
                PartitionKey what, Progress how_far);
  ~PartitionFeed() override = default;
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;

  const std::shared_ptr<PartitionReader> reader;
  const std::shared_ptr<GroupMember> member;
  const PartitionKey key;

  std::shared_ptr<KafkaClient> client;  ///< null once the feed is closed
  Queue queue;              ///< receives the partition's records; signals the reader when it becomes non-empty
  bool leaving = false;     ///< the group revokes the partition: nothing more is handed on
  bool complained = false;  ///< the last record was undecodable, and that was logged

  /// The subscription that reads it now; may be null.
  TopicSubscriber* reads_it() const { return static_cast<TopicSubscriber*>(subscriber.get()); }
};

/// This process as a member of one group. Guarded by the reader's mutex, except for the constants.
struct GroupMember {
  /// \param only the one partition of its topics that this member reads; nullopt: all that the group gives it.
  explicit GroupMember(std::string group, std::optional<std::int32_t> only = std::nullopt)
      : name(std::move(group)), partition(only) {}
  /// Whether it reads this partition if the group gives it.
  bool wants(std::int32_t number) const { return !partition || *partition == number; }
  const std::string name;
  const std::optional<std::int32_t> partition;
  bool connected = false;
  /// The first subscription to a topic reads it, the others stand by.
  std::vector<std::shared_ptr<TopicSubscriber>> subscribers;
  std::map<PartitionKey, std::shared_ptr<PartitionFeed>> feeds;
};

}  // namespace iotcloud::brokers::kafka
