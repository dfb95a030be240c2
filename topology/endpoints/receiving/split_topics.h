#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/endpoints/placement/partition_agreement.h>

namespace iotcloud::topology {

/// Follows into how many partitions the broker splits the topics of the shared channels that one spout component reads,
/// and tells the spout's PartitionAgreement of these and of the exclusive channels. All its functions must be called by
/// one thread at a time.
class SplitTopics {
 public:
  using Layout = PartitionAgreement::Layout;
  using Key = std::pair<brokers::BrokerAddress, brokers::Topic>;
  struct Options {
    std::string component;                    ///< for the log
    std::string group;                        ///< of the spout's readers, see PartitionAgreement::Source
    discovery::Registry* registry = nullptr;  ///< its dispatcher calls `on_change`; must outlive this object
    std::shared_ptr<PartitionAgreement> agreement;
    /// The client of the broker at an address. \throws config::Error when that broker cannot be used.
    std::function<std::shared_ptr<brokers::Broker>(const brokers::BrokerAddress&)> broker_at;
    /// Called on the registry's dispatcher when take_changes() has news. One call may stand for several changes.
    std::function<void()> on_change;
  };
  /// The channels that the spout has to place anew.
  struct Changes {
    bool all = false;                           ///< all channels: those of a driver instance agree no longer, or again
    std::set<discovery::InstanceId> instances;  ///< the topics of their channels have another number of partitions now
  };

  explicit SplitTopics(Options options) : options_(std::move(options)) {}
  ~SplitTopics() { end(); }
  SplitTopics(const SplitTopics&) = delete;
  SplitTopics& operator=(const SplitTopics&) = delete;

  /// From now on `on_change` may be called.
  void begin() IOTCLOUD_EXCLUDES(mutex_);
  /// Follows no topic any more. When it returns, `on_change` does not run, and is not called again.
  void end() IOTCLOUD_EXCLUDES(mutex_);

  /// Follows the topic of a channel, until forget() is called for each channel that uses it.
  /// \return the topic's number of partitions, 1 until the broker has told it; nullopt: the channel is exclusive, or
  /// this broker does not split topics, or it cannot be used.
  std::optional<int> follow(const discovery::ChannelRecord& channel, const Key& topic) IOTCLOUD_EXCLUDES(mutex_);
  /// The channel does not use the topic any more.
  void forget(const discovery::ChannelRecord& channel, const Key& topic);
  /// In what the channels of this channel's driver instance differ, and how to mend it; empty: they agree.
  std::string difference(const discovery::ChannelRecord& channel) const;
  /// Takes over the numbers of partitions that brokers have told since the last call.
  Changes take_changes() IOTCLOUD_EXCLUDES(mutex_);

 private:
  struct SplitTopic {
    std::shared_ptr<brokers::Broker> broker;         ///< must outlive the watch; null: it cannot be used
    std::unique_ptr<brokers::PartitionWatch> watch;  ///< null: the topic is not split
    std::optional<Layout> layout;                    ///< nullopt: not known yet
    std::map<discovery::InstanceId, discovery::ChannelRecord> channels;  ///< those that use it

    int partitions() const { return layout ? layout->partitions.value_or(1) : 1; }
  };

  void on_count(const Key& topic, int count) IOTCLOUD_EXCLUDES(mutex_);
  void change_soon() IOTCLOUD_REQUIRES(mutex_);
  PartitionAgreement::Source source_of(const discovery::ChannelRecord& channel) const;

  const Options options_;
  std::map<Key, SplitTopic> topics_;
  int listener_ = 0;  ///< number of the agreement's listener; 0: begin() was not called

  config::Mutex mutex_;
  bool over_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::map<Key, int> told_ IOTCLOUD_GUARDED_BY(mutex_);         ///< counts that take_changes() has not taken over
  bool agreement_changed_ IOTCLOUD_GUARDED_BY(mutex_) = false;  ///< since the last call of take_changes()
  discovery::GuardPtr soon_ IOTCLOUD_GUARDED_BY(mutex_);        ///< timer that calls on_change; null: none is planned
};

}  // namespace iotcloud::topology
