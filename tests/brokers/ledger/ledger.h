#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <ostream>
#include <string>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers {

/// A server (or cluster) that is killed and paused while its clients work.
struct Victim {
  BrokerOptions options;         ///< how clients reach it
  std::shared_ptr<void> server;  ///< lives as long as this struct
  std::function<void()> kill;    ///< sends SIGKILL; in a cluster to another node each time
  std::function<void()> start;   ///< starts again what was killed
  std::function<void()> pause;   ///< SIGSTOP; empty if this kind has no pause
  std::function<void()> resume;
  /// A killed server may have written a message, and not one of at least so many bytes before it. The publisher sends
  /// the missing one again, marked, and it comes after the later one.
  std::size_t gaps_from_bytes = std::numeric_limits<std::size_t>::max();
};
/// Starts a kind of broker (broker_kinds()), or one of three nodes: "cluster" (RabbitMQ with quorum queues),
/// "replicated_kafka" (topics of three partitions with three copies).
Victim make_victim(const std::string& kind);

/// The account of all messages of a run: sent, confirmed by the broker, received.
struct Ledger {
  std::uint64_t sent = 0;
  std::uint64_t confirmed = 0;
  std::uint64_t received = 0;             ///< distinct messages
  std::uint64_t lost = 0;                 ///< confirmed, but never received
  std::uint64_t duplicated = 0;           ///< further copies, marked as possibly redelivered
  std::uint64_t duplicated_unmarked = 0;  ///< further copies without that mark
  std::uint64_t out_of_order = 0;         ///< other first copies that came after a later message of their key
  std::uint64_t gaps = 0;        ///< first copies that did, marked, and so large that the killed server may have a gap
  std::uint64_t unanswered = 0;  ///< without any outcome at the end
  std::uint64_t refused = 0;     ///< refused by the broker, although no fault of the server justifies that
  std::uint64_t damaged = 0;     ///< received with other bytes than sent
  int kills = 0;
  int pauses = 0;
};
std::ostream& operator<<(std::ostream& out, const Ledger& ledger);

struct LedgerOptions {
  std::chrono::seconds duration{20};  ///< of load and faults; after it the server stays up and all messages must arrive
  std::chrono::seconds pause{6};      ///< longer than clients wait for a silent server
  std::chrono::milliseconds calm{1500};  ///< between two faults
};

/// Runs three durable topics, each with a publisher that sends messages of four keys (driver ids) and one reader, while
/// the server is repeatedly killed, started again and paused. Prints one line. Fails the test if a message was lost,
/// out of order, refused or damaged, or if a further copy is not marked.
Ledger run_ledger(const std::string& kind, const LedgerOptions& options);

}  // namespace iotcloud::brokers
