#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

/// Topologies that are submitted to pools of workers: what masters order, and what pools report. JSON in the registry.
namespace iotcloud::discovery {

/// A component library of a submitted topology, by its content.
struct SentLibrary {
  std::string name;    ///< as the YAML names it
  std::string file;    ///< plain file name, for people
  std::string sha256;  ///< the checksum under which pools keep it
  static constexpr const char* what = "a component library";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(name, required), IOTCLOUD_FIELD(file, required), IOTCLOUD_FIELD(sha256, required)};
  friend bool operator==(const SentLibrary&, const SentLibrary&) = default;
};

/// What the workers of a submitted topology run.
struct TopologyVersion {
  std::int64_t number = 0;  ///< from 1 on; grows with each submission, update and rollback
  std::string yaml;         ///< the topology's file
  std::vector<SentLibrary> libraries;
  std::string digest;  ///< SHA-256 over YAML and libraries: two versions with the same one do the same
  static constexpr const char* what = "a version of a topology";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(number, required), IOTCLOUD_FIELD(yaml, required),
                                            IOTCLOUD_FIELD(libraries, usual), IOTCLOUD_FIELD(digest, usual)};
  friend bool operator==(const TopologyVersion&, const TopologyVersion&) = default;
};

/// A topology that the pools run: persistent node `/iot/submissions/<name>/wanted`. The leading master writes it. The
/// pools share its worker places, 0 to `workers` - 1, among themselves. A node that vanishes ends no worker: only
/// `killed` does.
struct Submission {
  static constexpr int most_workers = 1000;
  TopologyName name;
  int workers = 1;
  TopologyVersion version;
  /// The version before the last update, which pools keep so that it can be rolled back.
  std::optional<TopologyVersion> previous;
  std::int64_t last_number = 0;  ///< the greatest TopologyVersion::number that the name has had
  int pending = 0;               ///< during an update: so many places, the last ones, still run `previous`
  bool killed = false;
  std::int64_t drain_ms = 0;  ///< when killed: how long a worker waits at most for tuples under way
  std::string manager;        ///< the manifest that it belongs to; empty: a person submitted it
  std::int64_t epoch = 0;     ///< fencing token: the epoch of the master that gave the order
  std::int64_t given_ms = 0;  ///< the master's wall time; grows with each change of this topology's submission
  static constexpr const char* what = "a submitted topology";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(name, required), IOTCLOUD_FIELD(workers, required),  IOTCLOUD_FIELD(version, required),
                 IOTCLOUD_FIELD(previous, rare), IOTCLOUD_FIELD(last_number, usual), IOTCLOUD_FIELD(pending, rare),
                 IOTCLOUD_FIELD(killed, rare),   IOTCLOUD_FIELD(drain_ms, rare),     IOTCLOUD_FIELD(manager, rare),
                 IOTCLOUD_FIELD(epoch, usual),   IOTCLOUD_FIELD(given_ms, rare)};
  /// What the worker at this place is to run.
  const TopologyVersion& version_of(int place) const {
    return previous && place >= workers - pending ? *previous : version;
  }
  friend bool operator==(const Submission&, const Submission&) = default;
};

/// The state of a worker place, as the pool that holds it reports it.
struct PlaceStatus {
  TopologyName topology;
  int place = 0;
  PoolId pool;               ///< set by the reader: whose record has it
  std::int64_t version = 0;  ///< TopologyVersion::number of what the worker runs, or is to run
  std::string state;         ///< "starting", "running", "stopping" or "failed"
  std::string reason;        ///< why, for people
  std::string worker;        ///< WorkerRecord::name; empty: not known yet
  std::int64_t since_ms = 0;
  static constexpr const char* what = "the state of a worker place";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(topology, required), IOTCLOUD_FIELD(place, required),
                 IOTCLOUD_FIELD(pool, usual),        IOTCLOUD_FIELD(version, usual),
                 IOTCLOUD_FIELD(state, required),    IOTCLOUD_FIELD(reason, usual),
                 IOTCLOUD_FIELD(worker, usual),      IOTCLOUD_FIELD_AS(since_ms, usual, "since_ms", sinceMs)};
  friend bool operator==(const PlaceStatus&, const PlaceStatus&) = default;
};

/// A pool of workers, and what it does: ephemeral node `/iot/pools/<id>`.
struct PoolRecord {
  PoolId id;
  std::string state_id;  ///< the random id of its state folder
  std::string host;      ///< of its Thrift service
  int port = 0;
  bool tls = false;                ///< whether the service speaks TLS
  int most_workers = 0;            ///< how many workers it runs at most; 0: no limit
  std::int64_t since_ms = 0;       ///< start of the process
  std::vector<std::string> files;  ///< SHA-256 of the component libraries that it keeps
  std::vector<PlaceStatus> places;
  std::string trouble;  ///< what it cannot do now; empty: nothing is known
  static constexpr const char* what = "a pool of workers";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD_AS(id, required, "pool", pool),
                                            IOTCLOUD_FIELD_AS(state_id, usual, "state_id", stateId),
                                            IOTCLOUD_FIELD(host, required),
                                            IOTCLOUD_FIELD(port, required),
                                            IOTCLOUD_FIELD(tls, rare),
                                            IOTCLOUD_FIELD_AS(most_workers, rare, "most_workers", mostWorkers),
                                            IOTCLOUD_FIELD_AS(since_ms, usual, "since_ms", sinceMs),
                                            IOTCLOUD_FIELD(files, usual),
                                            IOTCLOUD_FIELD(places, usual),
                                            IOTCLOUD_FIELD(trouble, rare)};
  friend bool operator==(const PoolRecord&, const PoolRecord&) = default;
};

/// What was ordered for a submitted topology, and what became of it.
struct TopologyEvent {
  std::int64_t time_ms = 0;  ///< the master's wall time
  std::string order;         ///< "submit", "update", "rollback" or "kill"
  std::int64_t version = 0;  ///< TopologyVersion::number that it led to
  std::string digest;        ///< TopologyVersion::digest
  int workers = 0;
  std::string outcome;  ///< for people
  static constexpr const char* what = "an event of a topology";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD_AS(time_ms, required, "time_ms", timeMs),
                                            IOTCLOUD_FIELD(order, required),
                                            IOTCLOUD_FIELD(version, usual),
                                            IOTCLOUD_FIELD(digest, usual),
                                            IOTCLOUD_FIELD(workers, usual),
                                            IOTCLOUD_FIELD(outcome, usual)};
  friend bool operator==(const TopologyEvent&, const TopologyEvent&) = default;
};

/// The latest events of a topology, the oldest first: persistent node `/iot/submissions/<name>/history`. Masters write
/// it; it stays when the topology is killed.
struct TopologyHistory {
  static constexpr std::size_t most = 100;
  std::vector<TopologyEvent> events;
  static constexpr const char* what = "the history of a topology";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(events, required)};
};

/// The pool that holds a worker place: ephemeral node `/iot/topologies/<name>/places/<number>`.
struct PlaceHolder {
  PoolId pool;
  std::string state_id;  ///< as in PoolRecord
  static constexpr const char* what = "the holder of a worker place";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(pool, required), IOTCLOUD_FIELD(state_id, usual)};
  friend bool operator==(const PlaceHolder&, const PlaceHolder&) = default;
};

/// A worker place of a submitted topology.
struct PlaceId {
  TopologyName topology;
  int number = 0;
  // clang-tidy 14 takes the zero that it compares with for a pointer: NOLINTNEXTLINE(modernize-use-nullptr)
  friend auto operator<=>(const PlaceId&, const PlaceId&) = default;
  friend bool operator==(const PlaceId&, const PlaceId&) = default;
};

std::string encode(const Submission& submission);
std::string encode(const PlaceHolder& holder);
std::string encode(const TopologyHistory& history);
std::string encode(const PoolRecord& record);
/// \throws config::Error that names `path` when the bytes hold no such record, or one with numbers out of range. Keys
/// that this program does not know are passed over.
Submission decode_submission(const std::string& bytes, const std::string& path);
/// As decode_submission().
TopologyHistory decode_history(const std::string& bytes, const std::string& path);
/// As decode_submission().
PoolRecord decode_pool(const std::string& bytes, const std::string& path);

/// The pools that live. A record that cannot be read is skipped, with a line in the log. \throws RegistryError.
std::vector<PoolRecord> list_pools(Registry& registry, const Paths& paths);
/// A submitted topology, with its node.
struct StandingSubmission {
  Submission submission;
  Node node;
};
/// All submissions, by name; those that cannot be read are skipped, with a line in the log. \throws RegistryError.
std::map<TopologyName, StandingSubmission> list_submissions(Registry& registry, const Paths& paths);
/// Who holds the places of these topologies. \throws RegistryError.
std::map<PlaceId, PlaceHolder> list_holders(Registry& registry, const Paths& paths,
                                            const std::vector<TopologyName>& topologies);

}  // namespace iotcloud::discovery
