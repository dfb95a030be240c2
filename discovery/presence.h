#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>

/// The nodes in which processes describe themselves, in JSON.
namespace iotcloud::discovery {

/// The process that is a gateway: its ephemeral node Paths::gateway_alive().
struct GatewayLife {
  std::string host;  ///< of its Thrift service
  int port = 0;      ///< of its Thrift service
  std::int64_t pid = 0;
  std::string state;  ///< the random id of its state folder; empty: it has none
  std::string run;    ///< random, of this run of the process; empty: an older gateway
  static constexpr const char* what = "the mark of a living gateway";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(host, usual), IOTCLOUD_FIELD(port, usual), IOTCLOUD_FIELD(pid, usual),
                 IOTCLOUD_FIELD(state, usual), IOTCLOUD_FIELD(run, rare)};
  friend bool operator==(const GatewayLife&, const GatewayLife&) = default;
};

/// ReaderRecord::engine: workers of ours, of a pool or started by hand; and Apache Storm.
inline constexpr const char* engine_workers = "workers";
inline constexpr const char* engine_storm = "storm";

/// A worker that reads a driver's channel as one of a group: an ephemeral node below Paths::readers().
struct ReaderRecord {
  TopologyName topology;
  int tasks = 1;              ///< 1 to max_tasks: its share of the topics grows with them
  bool shares = false;        ///< its YAML names the group
  std::string broker;         ///< the logical broker
  std::string where;          ///< which drivers, as the YAML says it
  std::int64_t since_ms = 0;  ///< when it joined, Unix time
  /// All spouts of its topology that read the driver in this group, with what decides about their shares; empty: one
  /// spout only, or an older worker.
  std::string spouts;
  std::string engine;  ///< what runs its topology: engine_workers, engine_storm; empty: an older worker, of either
  static constexpr int max_tasks = 1'000'000;
  static constexpr const char* what = "a reader of a group";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(topology, required), IOTCLOUD_FIELD(tasks, required),
                 IOTCLOUD_FIELD(shares, required),   IOTCLOUD_FIELD(broker, required),
                 IOTCLOUD_FIELD(where, required),    IOTCLOUD_FIELD_AS(since_ms, required, "since", since),
                 IOTCLOUD_FIELD(spouts, rare),       IOTCLOUD_FIELD(engine, rare)};
  friend bool operator==(const ReaderRecord&, const ReaderRecord&) = default;
};

/// The JSON of a record.
std::string encode(const GatewayLife& life);
std::string encode(const ReaderRecord& reader);
/// The record in such JSON. Keys that this program does not know are passed over. \throws config::Error that names
/// `path` when it holds no such record.
GatewayLife decode_life(const std::string& bytes, const std::string& path);
/// As decode_life().
ReaderRecord decode_reader(const std::string& bytes, const std::string& path);

}  // namespace iotcloud::discovery
