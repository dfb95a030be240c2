#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/processes/confinement.h>

/// What a pool and a worker that it started tell each other: files, and frames of JSON (processes/frames.h) on a
/// socket, on which the worker listens. They are in the worker's folder, in which a confined worker may write, but for
/// the pool's order to it, which lies beside the folder. A worker of another account than the pool's reads the YAML
/// there, writes to the file for its word, which the pool has made, and changes nothing else.
namespace iotcloud::topology::pooled {

/// Names in a worker's folder.
inline constexpr const char* yaml_name = "topology.yaml";
inline constexpr const char* end_name = "end.json";
inline constexpr const char* socket_name = "control.sock";

/// What a worker gives up before it loads a library (processes::Confinement).
struct WorkerConfinement {
  std::string user;
  std::uint64_t open_files = 0;
  std::uint64_t processes = 0;
  bool no_new_privileges = false;
  bool debuggable = true;
  bool filter_calls = false;
  std::optional<std::vector<std::string>> readable;  ///< with `writable`; nullopt: no restriction
  std::vector<std::string> writable;
  std::optional<std::vector<std::uint16_t>> ports;  ///< nullopt: no restriction
  static constexpr const char* what = "a worker's confinement";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(user, rare),        IOTCLOUD_FIELD(open_files, usual),
                                            IOTCLOUD_FIELD(processes, usual),  IOTCLOUD_FIELD(no_new_privileges, usual),
                                            IOTCLOUD_FIELD(debuggable, usual), IOTCLOUD_FIELD(filter_calls, usual),
                                            IOTCLOUD_FIELD(readable, rare),    IOTCLOUD_FIELD(writable, usual),
                                            IOTCLOUD_FIELD(ports, rare)};
};

/// The file FOLDER.json: what the pool wants of the worker. A pool that finds the worker of its former run reads it
/// again.
struct WorkerSpec {
  discovery::PoolId pool;
  discovery::TopologyName topology;
  int place = 0;
  std::int64_t version = 0;
  std::map<std::string, std::string> libraries;  ///< paths of component libraries, by how the YAML names them
  std::string log;                               ///< the file that stdout and stderr go to
  WorkerConfinement confinement;
  int log_limit_mb = 10;
  int logs_kept = 3;
  int listen_on = -1;  ///< a descriptor that is the worker's socket already; -1: it makes its socket
  static constexpr const char* what = "a pool's order to a worker";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(pool, required),      IOTCLOUD_FIELD(topology, required),
                                            IOTCLOUD_FIELD(place, required),     IOTCLOUD_FIELD(version, usual),
                                            IOTCLOUD_FIELD(libraries, usual),    IOTCLOUD_FIELD(log, usual),
                                            IOTCLOUD_FIELD(log_limit_mb, usual), IOTCLOUD_FIELD(logs_kept, usual),
                                            IOTCLOUD_FIELD(confinement, usual),  IOTCLOUD_FIELD(listen_on, usual)};
  discovery::PlaceId place_id() const { return {topology, place}; }
};

/// The file `end.json`, which the worker writes: why it ends. There is none, or an empty one, when the worker crashes,
/// or ends because it was told to.
struct WorkerEnd {
  bool refused = false;  ///< the topology cannot run here: to start it again would not help
  std::string reason;
  static constexpr const char* what = "a worker's end";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(refused, usual), IOTCLOUD_FIELD(reason, required)};
};

/// A frame of the worker: its state, at once when a pool connects, after each change, and as the answer to a ping.
struct WorkerReport {
  bool runs = false;   ///< the topology runs
  std::string worker;  ///< WorkerRecord::name; empty: it is not known yet
  /// \name The call of a component that has not returned for longest; only in answers to pings.
  /// @{
  std::string component = {};  ///< empty: none
  int task = 0;
  std::int64_t call_ms = 0;  ///< for how long
  /// @}
  static constexpr const char* what = "a worker's report";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(runs, required), IOTCLOUD_FIELD(worker, usual), IOTCLOUD_FIELD(component, rare),
                 IOTCLOUD_FIELD(task, rare), IOTCLOUD_FIELD(call_ms, rare)};
};

/// A frame of the pool.
struct PoolCommand {
  bool stop = false;  ///< drain and end; else a ping, which asks for a report
  static constexpr const char* what = "a pool's command";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(stop, required)};
};

/// The same in the terms of processes/confinement.h, and back.
processes::Confinement confinement_of(const WorkerConfinement& worker);
WorkerConfinement worker_confinement(const processes::Confinement& confinement);

std::string encode(const WorkerSpec& spec);
std::string encode(const WorkerEnd& end);
/// Frames.
std::string encode(const WorkerReport& report);
std::string encode(const PoolCommand& command);

/// Where the order to the worker of a folder is.
std::string spec_path(const std::string& folder);
/// \throws config::Error if there is no such file, or it does not say that.
WorkerSpec read_spec(const std::string& folder);
/// Removes the folder and the order of a worker that has ended.
void remove_worker(const std::string& folder);
/// nullopt: the worker has left no word.
std::optional<WorkerEnd> read_end(const std::string& folder);
/// From a frame's body. \throws config::Error if it is none.
WorkerReport decode_report(const std::string& body);
PoolCommand decode_command(const std::string& body);

}  // namespace iotcloud::topology::pooled
