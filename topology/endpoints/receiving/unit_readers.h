#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <utility>

#include <iotcloud/discovery/records.h>
#include <iotcloud/topology/endpoints/receiving/arrivals.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {

/// The readers of one unit of placement: one for each topic of its channels. Not thread safe.
class UnitReaders {
 public:
  using Key = std::pair<brokers::BrokerAddress, brokers::Topic>;
  /// The topics that are to be read, each with one of the channels that use it.
  using Wanted = std::map<Key, const discovery::ChannelRecord*>;
  /// Opens a reader; returns null if it cannot be opened now.
  using Open = std::function<std::shared_ptr<TopicReader>(const discovery::ChannelRecord&, const Key&)>;

  /// Of the readers of all units.
  struct Totals {
    std::size_t open = 0;
    std::size_t missing = 0;  ///< those that could not be opened
  };

  /// \param totals this object keeps them up to date; must outlive this object.
  explicit UnitReaders(Totals& totals) : totals_(totals) {}

  /// Closes the readers that are not in `wanted`.
  void keep_only(const Wanted& wanted);
  /// Opens the readers that are in `wanted` and missing.
  void open_missing(const Wanted& wanted, const Open& open);
  /// Whether open_missing() could not open one.
  bool lacks_one() const { return missing_ > 0; }
  /// Drains all readers (TopicReader::drain()).
  void drain();
  /// How many messages of the readers are not settled.
  std::size_t in_hand() const;
  /// How many of the readers get no more messages until some are settled (TopicReader::at_limit()).
  std::size_t at_limit() const;
  /// The greatest prefetch of a reader; 0: there is none.
  std::size_t prefetch() const;
  /// Asks the brokers what waits for the readers. \return how many readers there are
  std::size_t ask_backlog();
  /// Adds the answers.
  void add_backlog(Backlog& sum) const;
  /// How many messages the readers have brought.
  std::size_t taken() const;
  /// Whether the broker does not deliver to one of the readers (TopicReader::active()).
  bool cut_off() const;
  void close();

 private:
  void set_missing(std::size_t count);

  Totals& totals_;
  std::size_t missing_ = 0;
  std::map<Key, std::shared_ptr<TopicReader>> readers_;
};

}  // namespace iotcloud::topology
