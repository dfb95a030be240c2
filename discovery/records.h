#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>

namespace iotcloud::discovery {

/// Life of a driver instance. On the wire the original's TSensorState carries the nearest word, field 100 the exact
/// one.
enum class DriverState { deployed, starting, active, stopping, inactive, failed, undeployed, ordered };
/// The state's word in records and for people: "active".
std::string to_string(DriverState state);
DriverState parse_driver_state(const std::string& name);  ///< \throws config::Error
/// The state in JSON (description/json.h).
inline std::string json_value(DriverState state) {
  return to_string(state);
}
/// Reads what json_value() wrote. \throws config::Error.
inline void parse(const std::string& name, DriverState& state) {
  state = parse_driver_state(name);
}

/// The direction of a channel as its driver sees it: out = to the cloud. drivers::Direction is the same for authors of
/// drivers: there is no room that both rooms may use, so the driver host translates (gateway/host/channel_plan.cc).
enum class Direction { in = 0, out = 1 };
inline bool json_value(Direction direction) {
  return direction == Direction::out;
}
inline void parse(bool out, Direction& direction) {
  direction = out ? Direction::out : Direction::in;
}

/// One channel of a driver instance, as all processes see it (TChannel at
/// `/iot/sensors/<driver>/<instance>/<channel>`).
struct ChannelRecord {
  std::string name;
  std::string transport;  ///< the gateway's logical broker name ("rabbitmq")
  Direction direction = Direction::out;
  std::map<std::string, std::string> properties;  ///< raw, see channel_names.h
  std::string broker_url;                         ///< the broker that this channel's group was placed on
  GatewayId gateway;                              ///< TChannel.site
  DriverName driver;                              ///< TChannel.sensor
  InstanceId instance;                            ///< TChannel.sensorId
  bool shared = false;                            ///< TChannel.grouped
  static constexpr const char* what = "a channel";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD(name, required),
      IOTCLOUD_FIELD(transport, required),
      IOTCLOUD_FIELD_AS(direction, required, "out", direction),
      IOTCLOUD_FIELD(properties, required),
      IOTCLOUD_FIELD_AS(broker_url, required, "url", brokerUrl),
      IOTCLOUD_FIELD_AS(gateway, required, "gateway", site),
      IOTCLOUD_FIELD_AS(driver, required, "driver", sensor),
      IOTCLOUD_FIELD_AS(instance, required, "instance", sensorId),
      IOTCLOUD_FIELD_AS(shared, required, "shared", grouped),
  };
  friend bool operator==(const ChannelRecord&, const ChannelRecord&) = default;
};

/// One driver instance (TSensor at `/iot/sensors/<driver>/<instance>`).
struct DriverRecord {
  DriverName name;      ///< the driver's name ("turtle")
  InstanceId instance;  ///< UUID without dashes
  GatewayId gateway;
  DriverState state = DriverState::deployed;
  std::string reason;                           ///< why it is in this state, for people; field 101
  std::int64_t since_ms = 0;                    ///< wall time of the last change; field 102
  std::map<std::string, std::string> metadata;  ///< TSensor.metadata, as JSON
  std::vector<ChannelRecord> channels;
  std::string deployment;     ///< OrderRecord::name; field 106
  int index = 0;              ///< OrderRecord::index; field 107
  std::string plugin{};       ///< name of the plugin's file; empty: the gateway did not say
  std::string sha256{};       ///< the checksum of the plugin's bytes, in hexadecimal digits; empty: not known
  std::string signed_by{};    ///< the trusted key that signed the plugin; empty: none
  bool starts_again = false;  ///< it failed, and its gateway starts it again by itself; field 108
  std::string made_by{};      ///< OrderRecord::made_by; field 109
  /// `state` and `metadata` are missing here: the state takes two fields of TSensor, the metadata are JSON in one
  /// field, so records.cc converts them.
  static constexpr const char* what = "a driver";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD(name, required),
      IOTCLOUD_FIELD_AS(instance, usual, "instance", sensorId),
      IOTCLOUD_FIELD_AS(gateway, usual, "gateway", siteId),
      IOTCLOUD_FIELD(reason, usual),
      IOTCLOUD_FIELD_AS(since_ms, usual, "since_ms", sinceMs),
      IOTCLOUD_FIELD(channels, usual),
      IOTCLOUD_FIELD(deployment, rare),
      IOTCLOUD_FIELD(index, rare),
      IOTCLOUD_FIELD(plugin, rare),
      IOTCLOUD_FIELD(sha256, rare),
      IOTCLOUD_FIELD_AS(signed_by, rare, "signed_by", signedBy),
      IOTCLOUD_FIELD_AS(starts_again, rare, "starts_again", startsAgain),
      IOTCLOUD_FIELD_AS(made_by, rare, "made_by", madeBy),
  };
  friend bool operator==(const DriverRecord&, const DriverRecord&) = default;
};

/// The form of a gateway's brokers in TSite, which has a struct for each.
struct AsBrokers {
  /// One of them: TSite has a list of these, the record's JSON a list of names.
  struct Broker {
    std::string name;  ///< logical, as in GatewayRecord::brokers
    static constexpr const char* what = "a gateway's broker";
    static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(name, required)};
  };
  static std::vector<Broker> to(const std::vector<std::string>& names);
  static void from(std::vector<Broker> brokers, std::vector<std::string>& names);
};

/// One gateway (TSite at `/iot/gateways/<id>`; it lives while the ephemeral `/iot/gateways/<id>/alive` exists).
struct GatewayRecord {
  GatewayId id;
  std::string host;
  int port = 0;                      ///< of its Thrift service
  std::vector<std::string> brokers;  ///< logical names
  std::int64_t since_ms = 0;
  bool tls = false;       ///< whether its Thrift service speaks TLS
  std::string trouble{};  ///< what its drivers cannot do now (a broker is away, say); empty: nothing is known
  static constexpr const char* what = "a gateway";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD_AS(id, required, "gateway", siteId),
      IOTCLOUD_FIELD(host, required),
      IOTCLOUD_FIELD(port, required),
      IOTCLOUD_FIELD_IN(AsBrokers, brokers, usual, "brokers", brokers),
      IOTCLOUD_FIELD_AS(since_ms, usual, "since_ms", sinceMs),
      IOTCLOUD_FIELD(tls, rare),
      IOTCLOUD_FIELD(trouble, rare),
  };
  friend bool operator==(const GatewayRecord&, const GatewayRecord&) = default;
};

/// Which plugin an instance runs.
struct PluginVersion {
  std::string file;    ///< plain file name ("turtle.so")
  std::string sha256;  ///< the checksum under which the gateway stores an uploaded file; empty: the file is in the
                       ///< gateway's plugin folder
  static constexpr const char* what = "the version before an update";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD_AS(file, required, "plugin", plugin),
      IOTCLOUD_FIELD(sha256, usual),
  };
  friend bool operator==(const PluginVersion&, const PluginVersion&) = default;
};

/// The plugin and the settings that an instance is deployed with. It is a part of requests to a master, of orders in
/// the registry and of listings.
struct Deployment {
  DriverName driver;   ///< empty: the plugin's own
  std::string plugin;  ///< file name ("turtle.so"), in the gateway's plugin folder unless `sha256` is given
  bool active = true;  ///< wanted: active, or inactive until it is started
  std::map<std::string, std::string> properties;
  std::map<std::string, std::string> metadata;
  std::string name;     ///< with the gateway and a number it names an instance; empty: the instances have no names
  std::string manager;  ///< the manifest that it belongs to; empty: a person deployed it
  std::string sha256;   ///< the checksum of an uploaded plugin, see PluginVersion
  PluginVersion version() const { return {plugin, sha256}; }
  static constexpr const char* what = "a deployment";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD(driver, usual),     IOTCLOUD_FIELD(plugin, required), IOTCLOUD_FIELD(active, usual),
      IOTCLOUD_FIELD(properties, usual), IOTCLOUD_FIELD(metadata, usual),  IOTCLOUD_FIELD(name, rare),
      IOTCLOUD_FIELD(manager, rare),     IOTCLOUD_FIELD(sha256, rare),
  };
  friend bool operator==(const Deployment&, const Deployment&) = default;
};

/// The master's order for one instance on one gateway: `/iot/gateways/<id>/orders/<instance>`, JSON.
/// The gateway makes it so and reports in the DriverRecord. Removing the node is the order to undeploy.
struct OrderRecord : Deployment {
  InstanceId instance;
  int index = 0;  ///< from 1 on, unique within name and gateway; 0: it has no name
  /// Fencing token: the epoch of the master that gave the order. A gateway ignores orders of an older epoch than it has
  /// seen.
  std::int64_t epoch = 0;
  bool drained = false;  ///< inactive only while its gateway drains; wanted active after that
  /// During an update: the version that ran before, which the gateway keeps so that the update can be rolled back.
  std::optional<PluginVersion> previous;
  std::int64_t given_ms = 0;  ///< the master's wall time; grows with each change of an instance's order
  /// What made the instance, if no master did: "rule NAME" or "finder NAME" of the gateway's own file
  /// (gateway/provisioning/README.md). An order in the registry with it is a person's word about an instance that a
  /// rule makes: of the order only this, `active`, `drained` and `withheld` count.
  std::string made_by{};
  bool withheld = false;  ///< with `made_by`: the rule is not to make the instance, until it is started
  static constexpr const char* what = "an order";
  static constexpr auto fields =
      std::tuple_cat(Deployment::fields, std::tuple{IOTCLOUD_FIELD(instance, required), IOTCLOUD_FIELD(index, rare),
                                                    IOTCLOUD_FIELD(epoch, usual), IOTCLOUD_FIELD(drained, rare),
                                                    IOTCLOUD_FIELD(previous, rare), IOTCLOUD_FIELD(given_ms, rare),
                                                    IOTCLOUD_FIELD(made_by, rare), IOTCLOUD_FIELD(withheld, rare)});
  friend bool operator==(const OrderRecord&, const OrderRecord&) = default;
};

/// A master that signs its orders writes this before it removes an instance's order, so that a gateway can tell who
/// removed it: persistent node `/iot/gateways/<id>/removals/<instance>`, JSON. The gateway removes it afterwards.
struct OrderRemoval {
  InstanceId instance;
  std::int64_t epoch = 0;     ///< the master's
  std::int64_t given_ms = 0;  ///< later than OrderRecord::given_ms of the order that it ends
  static constexpr const char* what = "the removal of an order";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(instance, required), IOTCLOUD_FIELD(epoch, usual), IOTCLOUD_FIELD(given_ms, required)};
  friend bool operator==(const OrderRemoval&, const OrderRemoval&) = default;
};

/// Marks a gateway as draining: it takes no new instances, and its instances are stopped. Persistent node
/// `/iot/gateways/<id>/draining`, JSON; without the node the gateway does not drain.
struct DrainRecord {
  std::int64_t since_ms = 0;
  std::int64_t epoch = 0;  ///< the issuing master's
  static constexpr const char* what = "the mark of a gateway that drains";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(since_ms, usual), IOTCLOUD_FIELD(epoch, usual)};
  friend bool operator==(const DrainRecord&, const DrainRecord&) = default;
};

/// One running topology: `/iot/topologies/<name>`, JSON; its workers are ephemeral below .../workers.
struct TopologyRecord {
  TopologyName name;
  std::int64_t since_ms = 0;
  std::vector<std::string> spouts;
  std::vector<std::string> bolts;
  static constexpr const char* what = "a topology";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(name, required), IOTCLOUD_FIELD_AS(since_ms, usual, "since_ms", sinceMs),
                 IOTCLOUD_FIELD(spouts, usual), IOTCLOUD_FIELD(bolts, usual)};
  friend bool operator==(const TopologyRecord&, const TopologyRecord&) = default;
};

/// A topology's end: these workers (and no others) drain, leave an end report, and end.
struct TopologyKill {
  std::vector<std::string> workers;
  std::int64_t drain_ms = 0;          ///< how long a worker waits at most for tuples under way
  std::int64_t awaited_until_ms = 0;  ///< wall time until which a master waits for the end reports and clears up
  static constexpr const char* what = "an order to kill a topology";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(workers, required), IOTCLOUD_FIELD(drain_ms, required),
                                            IOTCLOUD_FIELD(awaited_until_ms, usual)};
  friend bool operator==(const TopologyKill&, const TopologyKill&) = default;
};

/// The wanted state of a running topology: persistent node `/iot/topologies/<name>/wanted`, JSON. Every worker, also
/// one that starts later, follows the order and reports the revision in its WorkerRecord. Without the node a topology
/// is active, with the parallelism that its YAML says.
struct TopologyOrder {
  std::int64_t revision = 0;  ///< grows with every order
  std::int64_t epoch = 0;     ///< fencing token: the epoch of the master that gave the order
  bool active = true;
  std::map<std::string, int> parallelism;  ///< in each worker, by component; what is not named stays as declared
  std::optional<TopologyKill> kill;
  std::int64_t given_ms =
      0;  ///< the master's wall time: a signed order that is older than the last one is not followed
  static constexpr const char* what = "an order to a topology";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(revision, required), IOTCLOUD_FIELD(epoch, usual), IOTCLOUD_FIELD(active, usual),
                 IOTCLOUD_FIELD(parallelism, usual), IOTCLOUD_FIELD(kill, rare),   IOTCLOUD_FIELD(given_ms, rare)};
  friend bool operator==(const TopologyOrder&, const TopologyOrder&) = default;
};

/// One worker, and what it does: ephemeral `/iot/topologies/<name>/workers/<worker>`, JSON.
struct WorkerRecord {
  /// The tasks of one component in this worker, as they are now.
  struct Component {
    int parallelism = 1;
    int tasks = 1;
    static constexpr const char* what = "a worker's component";
    static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(parallelism, required), IOTCLOUD_FIELD(tasks, required)};
    friend bool operator==(const Component&, const Component&) = default;
  };
  std::string name;  ///< unique for each process
  std::string host;
  std::int64_t pid = 0;
  std::string http;           ///< host:port of its pages; on its own machine, unless `tls`; empty: none
  std::string state;          ///< "active", "inactive", "draining"
  std::int64_t revision = 0;  ///< of the last order that the worker followed; 0: none
  std::string error;          ///< what the worker could not do of that order; empty: it did all
  std::int64_t since_ms = 0;  ///< start of the process
  std::string trouble;        ///< what it cannot do now (a broker is away, say); empty: nothing is known
  std::map<std::string, Component> components;
  bool tls = false;  ///< its pages take TLS and a token, so that other machines reach them
  static constexpr const char* what = "a worker";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD(name, required),    IOTCLOUD_FIELD(host, usual),
      IOTCLOUD_FIELD(pid, usual),        IOTCLOUD_FIELD(http, usual),
      IOTCLOUD_FIELD(state, usual),      IOTCLOUD_FIELD(revision, usual),
      IOTCLOUD_FIELD(error, usual),      IOTCLOUD_FIELD_AS(since_ms, usual, "since_ms", sinceMs),
      IOTCLOUD_FIELD(components, usual), IOTCLOUD_FIELD(trouble, rare),
      IOTCLOUD_FIELD(tls, rare),
  };
  friend bool operator==(const WorkerRecord&, const WorkerRecord&) = default;
};

/// The bytes of a record's node in the registry: TSensor, TChannel and TSite in Thrift's binary protocol without
/// framing, the other records in JSON.
std::string encode(const DriverRecord& record);
std::string encode(const ChannelRecord& record);
std::string encode(const GatewayRecord& record);
std::string encode(const OrderRecord& record);
std::string encode(const OrderRemoval& record);
std::string encode(const DrainRecord& record);
std::string encode(const TopologyRecord& record);
std::string encode(const TopologyOrder& order);
std::string encode(const WorkerRecord& record);
/// The record in such bytes. \throws config::Error that names `path` when they hold no such record, also when sizes in
/// them are hostile.
DriverRecord decode_driver(const std::string& bytes, const std::string& path);
/// As decode_driver().
ChannelRecord decode_channel(const std::string& bytes, const std::string& path);
/// As decode_driver().
GatewayRecord decode_gateway(const std::string& bytes, const std::string& path);
/// As decode_driver(), from JSON. Keys that this program does not know are passed over.
OrderRecord decode_order(const std::string& bytes, const std::string& path);
/// As decode_order().
OrderRemoval decode_removal(const std::string& bytes, const std::string& path);
/// As decode_order().
DrainRecord decode_drain(const std::string& bytes, const std::string& path);
/// As decode_order().
TopologyRecord decode_topology(const std::string& bytes, const std::string& path);
/// As decode_order().
TopologyOrder decode_topology_order(const std::string& bytes, const std::string& path);
/// As decode_order().
WorkerRecord decode_worker(const std::string& bytes, const std::string& path);

/// The paths of the records' nodes. `sensors_root` is the paper's zk.root; the other branches are its siblings.
struct Paths {
  explicit Paths(std::string sensors_root = "/iot/sensors");
  std::string driver(const DriverName& driver) const;
  std::string instance(const DriverName& driver, const InstanceId& instance) const;
  std::string channel(const DriverName& driver, const InstanceId& instance, const std::string& channel) const;
  std::string gateway(const GatewayId& id) const;  ///< `/iot/gateways/<id>`
  std::string gateway_alive(const GatewayId& id) const;
  std::string gateway_draining(const GatewayId& id) const;
  std::string orders(const GatewayId& id) const;
  std::string order(const GatewayId& id, const InstanceId& instance) const;
  std::string removals(const GatewayId& id) const;
  std::string removal(const GatewayId& id, const InstanceId& instance) const;
  std::string masters() const;                           ///< /iot/masters: the election's path
  std::string topology(const TopologyName& name) const;  ///< `/iot/topologies/<name>`
  std::string workers(const TopologyName& topology) const;
  std::string topology_order(const TopologyName& topology) const;  ///< `/iot/topologies/<name>/wanted`
  /// Below it each worker that was killed leaves a persistent node of its name: empty, or why it did not drain.
  std::string ended_workers(const TopologyName& topology) const;
  std::string submission(const TopologyName& topology) const;        ///< `/iot/submissions/<name>/wanted`
  std::string topology_history(const TopologyName& topology) const;  ///< `/iot/submissions/<name>/history`
  /// `/iot/topologies/<name>/places`: below it, by number, the places of workers that pools hold (ephemeral).
  std::string places(const TopologyName& topology) const;
  std::string place(const TopologyName& topology, int number) const;
  std::string pool(const PoolId& id) const;  ///< `/iot/pools/<id>`, ephemeral
  /// The readers that read a driver's channel as one group, and which of them reads what:
  /// `/iot/groups/<group>/<driver>/<channel>`.
  std::string readers(const std::string& group, const DriverName& driver, const std::string& channel) const;
  /// The nodes below which all records are: each kind of them has one.
  std::vector<std::string> branches() const;
  std::string sensors, gateways, topologies, groups, pools;
  std::string submissions;  ///< only masters change what is below it
};

/// A new instance id: a random UUID without dashes.
InstanceId new_instance_id();

}  // namespace iotcloud::discovery
