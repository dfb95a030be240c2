#pragma once

#include <chrono>
#include <optional>
#include <string>

#include <iotcloud/config/clock.h>
#include <iotcloud/discovery/presence.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::gateway {

/// A gateway's place in the registry: its record, and the ephemeral node that shows others that the gateway is alive.
/// Only one gateway with a given id can hold the place at a time, and one that was cut off for longer than its session
/// may find another one in it. Used on one thread.
class Membership {
 public:
  struct Options {
    discovery::GatewayRecord record;
    /// The random id of the state folder, which the gateway has locked. An ephemeral node with the same id is left from
    /// a dead run of this gateway, and join() replaces it at once. Empty: join() returns `taken` until that node's
    /// session has expired.
    std::string state_id;
    std::chrono::milliseconds session_timeout{10000};
    const config::Clock* clock = nullptr;  ///< not null
  };
  enum class Result {
    joined,
    away,   ///< the registry is unreachable, or refuses (problem()): try again
    taken,  ///< another gateway holds the id, or a dead one whose session has not expired: try again
  };

  Membership(discovery::Registry& registry, discovery::Paths paths, Options options);

  /// The holder of the place.
  enum class Holder {
    self,
    /// The node was removed, or its session has expired and this process's node is not there again yet. Or it is that
    /// of a dead run of this gateway, which came back with a backup of the registry and goes when its session expires.
    nobody,
    another,  ///< another process: holder_address()
  };

  Result join();
  /// The process that wrote the ephemeral node, after join() has returned `joined`.
  Holder holder(const std::optional<discovery::Node>& alive);
  /// After `nobody`: makes the ephemeral node again, as soon as that is possible.
  void hold_again();
  /// Writes the record if the registry does not have it. \throws discovery::RegistryError.
  void restore_record();
  /// Shows in the record what the drivers cannot do now; restore_record() writes it.
  void set_trouble(const std::string& trouble) { record_.trouble = trouble; }
  /// After `taken`: join() has been tried for so long that a dead gateway's session must have expired, so another
  /// gateway is alive.
  bool must_be_another() const { return must_be_another_; }
  /// How long after the first answer that the id is taken join() must still find it so.
  std::chrono::milliseconds patience() const { return options_.session_timeout + options_.session_timeout / 2; }
  /// Describes who holds the id, for the error message.
  const std::string& holder_address() const { return holder_address_; }
  /// After `away`: what the registry said.
  const std::string& problem() const { return problem_; }
  void leave() { alive_.reset(); }

 private:
  void write_record();
  bool is_own_predecessor(const discovery::Node& alive);
  discovery::GatewayLife read_holder(const discovery::Node& alive);

  discovery::Registry& registry_;
  const discovery::Paths paths_;
  const Options options_;
  discovery::GatewayRecord record_;
  const std::string identity_;  ///< data of the ephemeral node, JSON
  /// When the registry first answered `taken`; nullopt: it has not since it was away.
  std::optional<config::Clock::Instant> first_taken_;
  bool must_be_another_ = false;
  std::string holder_address_;
  std::string problem_;
  discovery::GuardPtr alive_;
};

}  // namespace iotcloud::gateway
