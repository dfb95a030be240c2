#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/sending/channel_sender.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Knows the way to every instance of a driver that has the channel and is chosen, as they come and go; shared by all
/// tasks of one bolt in a worker. Thread safe.
///
/// A driver's first message may be here before the registry has told of its channels: what is for an id that was never
/// seen waits `grace` for it. What is for one that is not there is counted, said in the log (a line every ten seconds
/// at most, with how many there were), and acked or failed as the endpoint's `unknownDriver` says.
class RouteTable {
 public:
  RouteTable(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint);
  ~RouteTable();

  /// The first task begins the search for drivers.
  void join();
  /// A task's collector goes; with the last one the search ends.
  void leave(const OutputCollector& collector);

  /// Sends to the instance that message.driver_id names; acks or fails the tuple, now or later.
  void send(brokers::Message message, const Tuple& tuple, OutputCollector& collector);
  /// Call it about once a second: gives up what waited too long for its driver, and keeps from timing out what waits
  /// for a broker.
  void on_tick();
  /// The topology stops: nothing waits for a driver any more.
  void end_grace();

  static constexpr std::chrono::seconds grace{2};
  /// More than so many tuples do not wait for drivers.
  static constexpr std::size_t most_waiting = 1024;

 private:
  using SenderKey = std::pair<brokers::BrokerAddress, brokers::Topic>;
  struct Route {
    std::shared_ptr<ChannelSender> sender;
    std::string gateway;
  };
  struct Waiting {
    brokers::Message message;
    Tuple tuple;
    OutputCollector* collector;
    config::Clock::Instant since;
  };

  void on_channel(const discovery::ChannelRecord& channel);
  void on_channel_gone(const discovery::ChannelRecord& channel);
  void on_verdict(const std::string& instance, std::optional<bool> chosen);
  bool fits(const discovery::ChannelRecord& channel);
  std::shared_ptr<ChannelSender> sender_for(const discovery::ChannelRecord& channel);
  void send_waiting(const std::string& driver_id);
  void give_up(const std::deque<Waiting>& late);
  void unknown(const std::string& driver_id, const Tuple& tuple, OutputCollector& collector);
  std::vector<std::shared_ptr<ChannelSender>> senders() const;
  std::shared_ptr<ChannelSender> drop(std::shared_ptr<ChannelSender> sender);

  const EndpointServicesPtr services_;
  const std::string component_;
  const EndpointDefinition endpoint_;

  std::mutex joining_;                                     ///< taken before mutex_, never by callbacks
  int tasks_ = 0;                                          ///< guarded by joining_
  std::unique_ptr<discovery::DriverDirectory> directory_;  ///< guarded by joining_

  mutable std::mutex mutex_;
  std::condition_variable sent_;
  std::shared_ptr<SenderMeters> meters_;                        ///< guarded by mutex_
  config::Counter* unknown_ = nullptr;                          ///< guarded by mutex_
  std::map<std::string, Route> routes_;                         ///< by driver instance; guarded by mutex_
  std::set<std::string> departed_;                              ///< instances seen and gone; guarded by mutex_
  std::set<std::string> unchosen_;                              ///< instances that are there; guarded by mutex_
  std::map<SenderKey, std::weak_ptr<ChannelSender>> senders_;   ///< guarded by mutex_
  std::size_t most_senders_ = 64;                               ///< before dead ones are swept out; guarded by mutex_
  std::map<std::shared_ptr<ChannelSender>, std::size_t> uses_;  ///< by how many routes; guarded by mutex_
  std::set<std::string> complained_;                            ///< guarded by mutex_
  std::map<std::string, std::deque<Waiting>> waiting_;          ///< by driver instance, in order; guarded by mutex_
  std::size_t waiting_count_ = 0;                               ///< guarded by mutex_
  OutputCollector* sending_ = nullptr;                  ///< guarded by mutex_; whose waiting tuple is being sent
  bool no_grace_ = false;                               ///< guarded by mutex_
  std::optional<config::Clock::Instant> last_unknown_;  ///< when the log was told; guarded by mutex_
  std::size_t untold_unknown_ = 0;                      ///< since then; guarded by mutex_
};

}  // namespace iotcloud::topology
