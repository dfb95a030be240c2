#pragma once

#include <chrono>
#include <string>

#include <iotcloud/config/clock.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::gateway {

/// A gateway's place in the registry: its record, and the ephemeral node by which others know that it lives. One
/// gateway of an id at a time. Used on one thread.
class Membership {
 public:
  struct Options {
    discovery::GatewayRecord record;
    /// Names the state folder, which the gateway has locked: a node that carries the same name is that of a dead
    /// predecessor and is taken over at once. Empty: such a node is waited for until its session has expired.
    std::string state_id;
    std::chrono::milliseconds session_timeout{10000};
    const config::Clock* clock = nullptr;  ///< not null
  };
  enum class Result {
    joined,
    away,   ///< the registry is not there: try again
    taken,  ///< another gateway of this id is alive, maybe a dead one whose session has not expired: try again
  };

  Membership(discovery::Registry& registry, discovery::Paths paths, Options options);

  Result join();
  /// After `taken`: no dead predecessor's node can live as long as this has been tried.
  bool hopeless() const;
  /// Who holds the id, for the message.
  const std::string& incumbent() const { return incumbent_; }
  void leave() { alive_.reset(); }

 private:
  void write_record();
  bool is_own_predecessor();

  discovery::Registry& registry_;
  const discovery::Paths paths_;
  const Options options_;
  const std::string identity_;  ///< data of the ephemeral node, JSON
  config::Clock::Instant first_try_{};
  bool tried_ = false;
  std::string incumbent_;
  discovery::GuardPtr alive_;
};

}  // namespace iotcloud::gateway
