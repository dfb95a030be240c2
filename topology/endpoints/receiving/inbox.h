#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

class ChannelReader;

/// The help text of iotcloud_spout_rejected_total, which is counted in two places.
inline constexpr const char* rejected_help = "Messages given up after their last try, and rejected";

/// A reader that has something in hand here as long as this lives. Movable.
class HeldReader {
 public:
  explicit HeldReader(std::shared_ptr<ChannelReader> reader);
  ~HeldReader();
  HeldReader(HeldReader&&) noexcept = default;
  HeldReader& operator=(HeldReader&& other) noexcept;
  ChannelReader* operator->() const { return reader_.get(); }
  const std::shared_ptr<ChannelReader>& shared() const { return reader_; }

 private:
  std::shared_ptr<ChannelReader> reader_;  ///< null: moved from
};

/// A message on its way from a channel into the topology.
struct Arrival {
  Arrival(brokers::Delivery received, std::shared_ptr<ChannelReader> from)
      : reader(std::move(from)), delivery(std::move(received)) {}

  HeldReader reader;
  brokers::Delivery delivery;  ///< goes first: what is not settled goes back before the reader has it no more in hand
  int tries = 0;               ///< how often it was emitted

  // Of Retries:
  std::uint64_t sequence = 0;  ///< its place among those of its task
  config::Clock::Instant not_before{};
  bool blocks = false;  ///< its driver's later messages wait for it
};

/// What waits for one spout task. Readers that bring more than `limit` are paused until half of it is gone, so that a
/// slow topology leaves its work in the broker. Thread safe.
class Inbox {
 public:
  Inbox(std::size_t limit, SpoutWaker waker) : limit_(limit), waker_(std::move(waker)) {}

  /// Called by a reader's handler: the tuple runs to completion on this thread when the spout is idle.
  void push(Arrival arrival);
  struct Taken {
    std::optional<Arrival> arrival;
    bool more = false;
  };
  Taken pop();
  /// Drops what came from a reader that was closed (its broker delivers it again) and lets others go on.
  void forget(const ChannelReader& reader);
  /// What comes from now on, and what waits, goes back to the broker.
  void close();
  std::size_t size() const;

 private:
  void resume_when_half_empty();

  const std::size_t limit_;
  const SpoutWaker waker_;
  mutable std::mutex mutex_;
  bool closed_ = false;                                 ///< guarded by mutex_
  std::deque<Arrival> waiting_;                         ///< guarded by mutex_
  std::vector<std::shared_ptr<ChannelReader>> paused_;  ///< guarded by mutex_
};

}  // namespace iotcloud::topology
