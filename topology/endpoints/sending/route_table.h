#pragma once

#include <chrono>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/sending/channel_sender.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Knows the sender of every driver instance that has the endpoint's channel and that `where` chooses, as instances
/// come and go. All tasks of one bolt in a worker share it. Thread safe.
///
/// A tuple for a driver may be here before the registry has told of the driver's channels: tuples for an id that was
/// never seen wait for `grace`, and so do those for an instance that has just become inactive or failed for good, or
/// whose record has just gone (a registry that was emptied gets the records of running instances again). An inactive
/// instance may have begun again: what it sends then may come sooner than the registry's word. So tuples for it wait
/// for `grace` from the first one on, and those that follow this one after that do not, until none came for `grace`.
/// Tuples for an instance that is about to be active (deployed, starting, stopping for a restart, or failed while its
/// gateway starts it again by itself) wait for it up to their deadline, or for `return_limit` if they have none. A
/// tuple that nobody gets is counted under its reason (Reason), logged (one line every ten seconds at most, with the
/// number of such tuples), and acked or failed as the endpoint's `unknownDriver` says. A tuple whose deadline passes is
/// counted and acked.
class RouteTable {
 public:
  RouteTable(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint);
  ~RouteTable();

  /// A task calls it when it is prepared. The first call begins the search for drivers.
  void join();
  /// A task calls it before its collector goes. The last call ends the search.
  void leave(const OutputCollector& collector);

  /// Sends to the instance that message.driver_id names; acks or fails the tuple, before it returns or later.
  void send(brokers::Message message, const Tuple& tuple, OutputCollector& collector);
  /// Must be called about once a second: gives up tuples that waited too long for their driver, and restarts the
  /// message time-out of tuples that wait for a broker.
  void on_tick();
  /// The topology stops: gives up all tuples that wait for a driver, and lets none wait any more. Those for an instance
  /// that is about to be active fail, so that the next worker sends them.
  void end_grace();

  static constexpr std::chrono::seconds grace{2};          ///< how long a tuple waits for a driver that was never seen
  static constexpr std::chrono::seconds return_limit{60};  ///< how long one without a deadline waits for a restart
  /// How many tuples wait for drivers at most; further ones are dropped (Reason::too_many_wait). Those for an instance
  /// that is about to be active wait all the same: they are not more than the spouts have under way.
  static constexpr std::size_t most_waiting = 10'000;

 private:
  using SenderKey = std::pair<brokers::BrokerAddress, brokers::Topic>;
  struct Route {
    std::shared_ptr<ChannelSender> sender;
    discovery::GatewayId gateway;
  };
  using Instant = config::Clock::Instant;
  struct Waiting {
    brokers::Message message;
    Tuple tuple;
    OutputCollector* collector;
    Instant since;
  };
  /// Why nobody gets a tuple.
  enum class Reason {
    unknown,        ///< its instance has no record, or `where` does not choose it
    inactive,       ///< its instance is stopped, or has failed for good
    not_started,    ///< its instance is still about to be active
    no_channel,     ///< its instance is active, without a channel that can be used
    too_many_wait,  ///< it would wait, but `most_waiting` do so already
    deadline,
  };
  struct Dropped {
    Waiting waiting;
    Reason reason;
  };
  /// What an instance's record says, and since when it does.
  struct Known {
    discovery::DriverState state;
    bool starts_again;
    Instant since;
    // Of an inactive instance: tuples for it that came, or were given up, without a pause of `grace`.
    Instant first_tuple = Instant::min();
    std::optional<Instant> last_tuple{};
  };

  void on_channel(const discovery::ChannelRecord& channel);
  void on_channel_gone(const discovery::ChannelRecord& channel);
  void on_choice(const discovery::InstanceId& instance, std::optional<bool> chosen);
  void on_record(const discovery::InstanceId& instance, const discovery::DriverRecord* record);
  void note_tuple(std::string_view instance, Instant now) IOTCLOUD_REQUIRES(mutex_);
  Known* inactive(std::string_view instance) IOTCLOUD_REQUIRES(mutex_);
  bool comes(std::string_view instance) const IOTCLOUD_REQUIRES(mutex_);
  Instant end_of_wait(std::string_view instance, Instant since) const IOTCLOUD_REQUIRES(mutex_);
  bool fits(const discovery::ChannelRecord& channel);
  std::shared_ptr<ChannelSender> sender_for(const discovery::ChannelRecord& channel);
  void send_waiting(const discovery::InstanceId& instance);
  Reason why_nobody(std::string_view instance) const IOTCLOUD_REQUIRES(mutex_);
  Reason why_late(const Waiting& waiting, Instant now) const IOTCLOUD_REQUIRES(mutex_);
  void drop(Reason reason, const std::string& instance, const Tuple& tuple, OutputCollector& collector);
  std::string line_about(Reason reason, const std::string& instance) const;
  std::vector<std::shared_ptr<ChannelSender>> senders() const;
  std::shared_ptr<ChannelSender> drop(std::shared_ptr<ChannelSender> sender) IOTCLOUD_REQUIRES(mutex_);

  const EndpointServicesPtr services_;
  const std::string component_;
  const EndpointDefinition endpoint_;

  config::Mutex joining_ IOTCLOUD_ACQUIRED_BEFORE(mutex_);  ///< callbacks never take it
  int tasks_ IOTCLOUD_GUARDED_BY(joining_) = 0;
  std::unique_ptr<discovery::DriverDirectory> directory_ IOTCLOUD_GUARDED_BY(joining_);

  mutable config::Mutex mutex_;
  config::ConditionVariable sent_;
  std::shared_ptr<SenderMeters> meters_ IOTCLOUD_GUARDED_BY(mutex_);
  config::Counter* unknown_ IOTCLOUD_GUARDED_BY(mutex_) = nullptr;
  std::map<discovery::InstanceId, Route, std::less<>> routes_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<discovery::InstanceId, Known, std::less<>> known_ IOTCLOUD_GUARDED_BY(mutex_);       ///< those with a record
  std::map<discovery::InstanceId, Instant, std::less<>> departed_ IOTCLOUD_GUARDED_BY(mutex_);  ///< when records went
  std::set<discovery::InstanceId, std::less<>> unchosen_ IOTCLOUD_GUARDED_BY(mutex_);  ///< exist but are not chosen
  std::map<SenderKey, std::weak_ptr<ChannelSender>> senders_ IOTCLOUD_GUARDED_BY(mutex_);
  std::size_t most_senders_ IOTCLOUD_GUARDED_BY(mutex_) = 64;  ///< the size at which expired entries are removed
  /// The number of routes of each sender.
  std::map<std::shared_ptr<ChannelSender>, std::size_t> uses_ IOTCLOUD_GUARDED_BY(mutex_);
  std::set<std::string> complained_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<discovery::InstanceId, std::deque<Waiting>, std::less<>> waiting_ IOTCLOUD_GUARDED_BY(mutex_);  ///< in order
  std::size_t waiting_count_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  OutputCollector* sending_ IOTCLOUD_GUARDED_BY(mutex_) = nullptr;  ///< the collector whose waiting tuple is being sent
  bool no_grace_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  /// When drop() wrote a line in the log.
  std::optional<config::Clock::Instant> last_told_ IOTCLOUD_GUARDED_BY(mutex_);
  /// Number of tuples that were dropped since then.
  std::size_t untold_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
};

}  // namespace iotcloud::topology
