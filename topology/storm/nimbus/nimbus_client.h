#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/error.h>

namespace iotcloud::topology::storm {

/// The version of Storm with which all this was tested.
inline constexpr const char* tested_version = "2.8.3";

/// Nimbus refused, or none answers. what() says why and what to do.
class NimbusError : public config::Error {
 public:
  using Error::Error;
};

/// A topology of the cluster.
struct RunningTopology {
  std::string id;
  std::string name;
  std::string status;  ///< ACTIVE, INACTIVE, KILLED, REBALANCING
  int tasks = 0;
  int executors = 0;
  int workers = 0;
  int uptime_s = 0;
};

/// An executor that Nimbus has given to a worker.
struct RunningExecutor {
  std::string component;
  int first_task = 0;
  int last_task = 0;
  std::string host;
  int port = 0;
  int uptime_s = 0;
  bool reported = false;  ///< it has told Nimbus of itself, so it runs
};

/// An error that a component reported.
struct ReportedError {
  std::string component;
  std::string text;
  std::int64_t at_s = 0;  ///< since 1970 UTC
  std::string host;
  int port = 0;
  bool of_tuple = false;  ///< a C++ component failed a tuple, and goes on; else its worker ended

  bool operator==(const ReportedError&) const = default;
};

/// The counts of a component in all its tasks, as Storm samples them.
struct ComponentCounts {
  std::string component;
  bool spout = false;
  int executors = 0;
  int tasks = 0;
  std::int64_t emitted = 0;
  std::int64_t transferred = 0;
  std::int64_t executed = 0;  ///< bolts
  std::int64_t acked = 0;
  std::int64_t failed = 0;
  double execute_ms = 0;   ///< bolts: duration of execute()
  double process_ms = 0;   ///< bolts: until the ack
  double complete_ms = 0;  ///< spouts: until the tree is done
  std::string last_error;  ///< empty: none
  double capacity = 0;     ///< bolts: part of the last minutes in which its busiest executor was busy
};

/// A running topology, with what its executors report.
struct TopologyDetails {
  RunningTopology topology;
  std::vector<RunningExecutor> executors;  ///< Storm's own left out
  std::vector<ReportedError> errors;       ///< the newest first
};

/// Talks to the leader of a cluster's Nimbuses, also when another one leads than before. Used by one thread.
class NimbusClient {
 public:
  /// Connects to the leader. \param addresses HOST:PORT of some Nimbuses. \param patience for how long it looks for a
  /// leader, now and after each failover, and so for another one when the leader fails. \throws NimbusError when none
  /// answers in time.
  explicit NimbusClient(std::vector<std::string> addresses,
                        std::chrono::milliseconds patience = std::chrono::seconds(30));
  ~NimbusClient();
  NimbusClient(const NimbusClient&) = delete;
  NimbusClient& operator=(const NimbusClient&) = delete;

  // All calls throw NimbusError.

  std::string leader() const;   ///< HOST:PORT
  std::string version() const;  ///< Storm's version there

  /// Sends a jar and starts a topology of it. \param progress gets the sent and the whole number of bytes; may be empty
  void submit(const std::string& name, const std::string& conf, const std::string& topology, const std::string& jar,
              const std::function<void(std::size_t, std::size_t)>& progress);
  std::vector<RunningTopology> topologies();
  /// nullopt: there is none of that name.
  std::optional<TopologyDetails> details(const std::string& name);
  /// \param window "600", "10800", "86400" seconds or ":all-time"
  std::vector<ComponentCounts> counts(const std::string& name, const std::string& window);
  void activate(const std::string& name);
  void deactivate(const std::string& name);
  /// \param workers nullopt: as many as now
  /// \param executors the new number of each component that changes
  void rebalance(const std::string& name, std::optional<int> workers, const std::map<std::string, int>& executors,
                 std::chrono::seconds wait);
  void kill(const std::string& name, std::chrono::seconds wait);
  /// Changes the levels of a topology's loggers in its workers. \param levels "DEBUG", ..., by logger's name; empty: as
  /// before the first change. \param time_out after which they are as before; 0: none
  void set_log_levels(const std::string& name, const std::map<std::string, std::string>& levels,
                      std::chrono::seconds time_out);

 private:
  std::string id_of(const std::string& name);

  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::topology::storm
