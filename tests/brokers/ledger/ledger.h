#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <ostream>
#include <string>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers {

/// A server (or cluster) that is tormented while its clients work.
struct Victim {
  BrokerOptions options;         ///< how clients reach it
  std::shared_ptr<void> server;  ///< lives as long as this
  std::function<void()> kill;    ///< SIGKILL; of a cluster one node, another one each time
  std::function<void()> start;   ///< after kill
  std::function<void()> pause;   ///< SIGSTOP; empty: this kind cannot
  std::function<void()> resume;
};
/// A fresh one: a kind of broker (broker_kinds()), or one of three nodes: "cluster" (RabbitMQ with quorum queues),
/// "replicated_kafka" (topics of three partitions with three copies).
Victim make_victim(const std::string& kind);

/// The account of all messages of a run: what was sent, what the broker confirmed, what arrived.
struct Ledger {
  std::uint64_t sent = 0;
  std::uint64_t confirmed = 0;
  std::uint64_t received = 0;             ///< different messages
  std::uint64_t lost = 0;                 ///< confirmed, and never received
  std::uint64_t duplicated = 0;           ///< further copies, marked as possibly redelivered
  std::uint64_t duplicated_unmarked = 0;  ///< further copies that are not
  std::uint64_t out_of_order = 0;         ///< first copies that came after a later message of their key
  std::uint64_t unanswered = 0;           ///< neither confirmed in the end nor anything else
  std::uint64_t refused = 0;              ///< by the broker; no fault of the server is a reason for that
  std::uint64_t damaged = 0;              ///< received with other bytes than were sent
  int kills = 0;
  int pauses = 0;
};
std::ostream& operator<<(std::ostream& out, const Ledger& ledger);

struct LedgerOptions {
  std::chrono::seconds duration{20};     ///< of load and faults; then the server stays up and everything must arrive
  std::chrono::seconds pause{6};         ///< longer than the clients' patience with a silent server
  std::chrono::milliseconds calm{1500};  ///< between two faults
};

/// Three durable topics, each with a publisher that sends messages of four keys (driver ids) and one reader, while the
/// server is killed, started again and paused, again and again. Prints one line and fails the test when a message was
/// lost, overtaken, refused or damaged, or a further copy of one is not marked.
Ledger run_ledger(const std::string& kind, const LedgerOptions& options);

}  // namespace iotcloud::brokers
