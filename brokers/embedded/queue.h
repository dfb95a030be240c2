#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::embedded {

using Instant = config::Clock::Instant;

class Queue;
class EmbeddedConnection;

/// A message in a queue.
struct StoredMessage {
  Message message;
  std::uint64_t sequence = 0;      ///< its place in the queue, which it keeps when it is put back
  std::optional<Instant> expires;  ///< when it is dropped; nullopt: never
  bool redelivered = false;
  std::uint32_t tries = 0;  ///< how often its current reader got it
};

/// The server's side of one subscription. Guarded by the server's mutex, except constants.
struct Consumer {
  Topic topic;
  SubscriptionOptions options;
  EmbeddedConnection* connection = nullptr;  ///< must outlive the consumer

  std::shared_ptr<Queue> queue;  ///< null while the server is away
  bool active = false;           ///< gets messages; false: exclusivity forbids it, or the server is away
  bool paused = false;
  bool closed = false;
  bool in_ready = false;  ///< is in EmbeddedConnection::ready
  bool running = false;   ///< its handler runs
  std::uint64_t last_tag = 0;
  std::map<std::uint64_t, StoredMessage> unsettled;  ///< by tag

  bool can_take() const;
};

/// One queue with its readers. Has no lock: guarded by the server's mutex.
class Queue {
 public:
  Queue(std::string name, bool durable, Instant made = {})
      : name_(std::move(name)), durable_(durable), unused_since_(made) {}

  const std::string& name() const { return name_; }
  bool durable() const { return durable_; }
  std::size_t size() const { return items_.size(); }
  std::size_t bytes() const { return bytes_; }
  bool has_readers() const { return !readers_.empty(); }
  Instant unused_since() const { return unused_since_; }
  /// All readers, oldest first. Inactive ones wait to take over.
  const std::vector<std::shared_ptr<Consumer>>& readers() const { return readers_; }

  /// Appends a message.
  void push(Message message, std::optional<Instant> expires, bool possibly_redelivered = false);
  /// Puts a message back in its old place.
  void put_back(StoredMessage stored);
  /// Takes the oldest message that has not expired; nullopt if there is none.
  std::optional<StoredMessage> pop(Instant now);
  /// Drops the oldest messages until `keep` are left. \return how many it dropped.
  std::size_t trim(std::size_t keep);
  /// Messages that readers have and have not settled.
  std::size_t unsettled() const;

  /// Adds a reader, which becomes active unless its own or another's exclusivity forbids it.
  void attach(const std::shared_ptr<Consumer>& consumer);
  /// Removes a reader, puts its unsettled messages back and lets the next one take over.
  void detach(Consumer& consumer, Instant now);

 private:
  void activate();

  const std::string name_;
  const bool durable_;
  std::deque<StoredMessage> items_;  ///< ascending in `sequence`
  std::size_t bytes_ = 0;
  std::uint64_t last_sequence_ = 0;
  std::vector<std::shared_ptr<Consumer>> readers_;  ///< oldest first
  Instant unused_since_{};
};

}  // namespace iotcloud::brokers::embedded
