#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace iotcloud::discovery {

/// Life of a driver instance. On the wire the original's TSensorState carries the nearest word, field 100 the exact
/// one.
enum class DriverState { deployed, starting, active, stopping, inactive, failed, undeployed };
std::string to_string(DriverState state);
DriverState parse_driver_state(const std::string& name);  ///< \throws config::Error

enum class Direction { in = 0, out = 1 };  ///< seen from the driver: out = to the cloud

/// One channel of a driver instance, as all processes see it (TChannel at /iot/sensors/<driver>/<instance>/<channel>).
struct ChannelRecord {
  std::string name;
  std::string transport;  ///< the gateway's logical broker name ("rabbitmq")
  Direction direction = Direction::out;
  std::map<std::string, std::string> properties;  ///< exchange, routingKey, queueName (wire names), topic, durable
  std::string broker_url;                         ///< the broker that this channel's group was placed on
  std::string gateway;                            ///< TChannel.site
  std::string driver;                             ///< TChannel.sensor
  std::string instance;                           ///< TChannel.sensorId
  bool shared = false;                            ///< TChannel.grouped
  friend bool operator==(const ChannelRecord&, const ChannelRecord&) = default;
};

/// One driver instance (TSensor at /iot/sensors/<driver>/<instance>).
struct DriverRecord {
  std::string name;      ///< the driver's name ("turtle")
  std::string instance;  ///< UUID without dashes
  std::string gateway;
  DriverState state = DriverState::deployed;
  std::string reason;                           ///< why it is in this state, for people; field 101
  std::int64_t since_ms = 0;                    ///< wall time of the last change; field 102
  std::map<std::string, std::string> metadata;  ///< TSensor.metadata, as JSON
  std::vector<ChannelRecord> channels;
  std::string deployment;   ///< OrderRecord::name; field 106
  int index = 0;            ///< OrderRecord::index; field 107
  std::string plugin{};     ///< its file's name; empty: not said
  std::string sha256{};     ///< of the plugin's bytes, in hexadecimal digits; empty: not known
  std::string signed_by{};  ///< the trusted key that signed the plugin; empty: none
  friend bool operator==(const DriverRecord&, const DriverRecord&) = default;
};

/// One gateway (TSite at /iot/gateways/<id>; it lives while the ephemeral /iot/gateways/<id>/alive exists).
struct GatewayRecord {
  std::string id;
  std::string host;
  int port = 0;                      ///< of its Thrift service
  std::vector<std::string> brokers;  ///< logical names
  std::int64_t since_ms = 0;
  bool tls = false;  ///< whether its Thrift service speaks TLS
  friend bool operator==(const GatewayRecord&, const GatewayRecord&) = default;
};

/// Which plugin an instance runs.
struct PluginVersion {
  std::string file;    ///< plain file name ("turtle.so")
  std::string sha256;  ///< of an uploaded file, which the gateway keeps by it; empty: of the gateway's plugin folder
  friend bool operator==(const PluginVersion&, const PluginVersion&) = default;
};

/// What the master wants of one instance on one gateway: /iot/gateways/<id>/orders/<instance>, JSON.
/// The gateway makes it so and reports in the DriverRecord. Removing the node is the order to undeploy.
struct OrderRecord {
  std::string instance;
  std::string driver;  ///< name; empty: the plugin's own
  std::string plugin;  ///< file name ("turtle.so"), in the gateway's plugin folder unless `sha256` is given
  bool active = true;  ///< wanted: active or inactive
  std::map<std::string, std::string> properties;
  std::map<std::string, std::string> metadata;
  std::int64_t epoch =
      0;               ///< fencing: the issuing master's; a gateway ignores orders of an older epoch than it has seen
  std::string name{};  ///< of its deployment; empty: it has none
  int index = 0;       ///< from 1 on, unique within name and gateway; 0: it has no name
  std::string manager{};  ///< the manifest that it belongs to; empty: a person deployed it
  bool drained = false;   ///< inactive only while its gateway drains; wanted active after that
  std::string sha256{};   ///< of an uploaded plugin, see PluginVersion
  /// While an update is under way: what ran before, which the gateway keeps so that the update can go back.
  std::optional<PluginVersion> previous{};
  PluginVersion version() const { return {plugin, sha256}; }
  friend bool operator==(const OrderRecord&, const OrderRecord&) = default;
};

/// A gateway that drains takes no new instances, and those that it has are stopped: /iot/gateways/<id>/draining, JSON,
/// persistent. No node: it does not.
struct DrainRecord {
  std::int64_t since_ms = 0;
  std::int64_t epoch = 0;  ///< the issuing master's
  friend bool operator==(const DrainRecord&, const DrainRecord&) = default;
};

/// One running topology: /iot/topologies/<name>, JSON; its workers are ephemeral below .../workers.
struct TopologyRecord {
  std::string name;
  std::int64_t since_ms = 0;
  std::vector<std::string> spouts;
  std::vector<std::string> bolts;
  friend bool operator==(const TopologyRecord&, const TopologyRecord&) = default;
};

/// What is wanted of a running topology: /iot/topologies/<name>/wanted, JSON, persistent. Every worker makes it so,
/// those that start later too, and reports the revision in its WorkerRecord. No node: active, parallelism as in the
/// YAML.
struct TopologyOrder {
  std::int64_t revision = 0;  ///< grows with every order
  std::int64_t epoch = 0;     ///< fencing: the issuing master's
  bool active = true;
  std::map<std::string, int> parallelism;  ///< in each worker, by component; what is not named stays as declared
  /// The end: these workers (and no others) drain, leave an end report, and end.
  struct Kill {
    std::vector<std::string> workers;
    std::int64_t drain_ms = 0;          ///< what is under way is waited for so long at most
    std::int64_t awaited_until_ms = 0;  ///< wall time until which a master waits for the end reports and clears up
    friend bool operator==(const Kill&, const Kill&) = default;
  };
  std::optional<Kill> kill;
  friend bool operator==(const TopologyOrder&, const TopologyOrder&) = default;
};

/// One worker, and what it does: ephemeral /iot/topologies/<name>/workers/<worker>, JSON.
struct WorkerRecord {
  struct Component {
    int parallelism = 1;
    int tasks = 1;
    friend bool operator==(const Component&, const Component&) = default;
  };
  std::string name;  ///< unique for each process
  std::string host;
  std::int64_t pid = 0;
  std::string http;           ///< host:port of its pages, on its own machine; empty: none
  std::string state;          ///< "active", "inactive", "draining"
  std::int64_t revision = 0;  ///< of the last order that was followed; 0: none
  std::string error;          ///< what of that order could not be done; empty: all was
  std::int64_t since_ms = 0;  ///< start of the process
  std::map<std::string, Component> components;
  friend bool operator==(const WorkerRecord&, const WorkerRecord&) = default;
};

/// Bytes as they stand in the registry: TSensor, TChannel and TSite in Thrift's binary protocol without framing.
/// decode_* \throws config::Error naming `path` when the bytes are none (hostile sizes included).
std::string encode(const DriverRecord& record);
std::string encode(const ChannelRecord& record);
std::string encode(const GatewayRecord& record);
std::string encode(const OrderRecord& record);
std::string encode(const DrainRecord& record);
std::string encode(const TopologyRecord& record);
std::string encode(const TopologyOrder& order);
std::string encode(const WorkerRecord& record);
DriverRecord decode_driver(const std::string& bytes, const std::string& path);
ChannelRecord decode_channel(const std::string& bytes, const std::string& path);
GatewayRecord decode_gateway(const std::string& bytes, const std::string& path);
OrderRecord decode_order(const std::string& bytes, const std::string& path);
DrainRecord decode_drain(const std::string& bytes, const std::string& path);
TopologyRecord decode_topology(const std::string& bytes, const std::string& path);
TopologyOrder decode_topology_order(const std::string& bytes, const std::string& path);
WorkerRecord decode_worker(const std::string& bytes, const std::string& path);

/// Where records stand. `sensors_root` is the paper's zk.root; the other branches are its siblings.
struct Paths {
  explicit Paths(std::string sensors_root = "/iot/sensors");
  std::string driver(const std::string& driver) const;
  std::string instance(const std::string& driver, const std::string& instance) const;
  std::string channel(const std::string& driver, const std::string& instance, const std::string& channel) const;
  std::string gateway(const std::string& id) const;  ///< /iot/gateways/<id>
  std::string gateway_alive(const std::string& id) const;
  std::string gateway_draining(const std::string& id) const;
  std::string orders(const std::string& id) const;
  std::string order(const std::string& id, const std::string& instance) const;
  std::string masters() const;                          ///< /iot/masters: the election's path
  std::string topology(const std::string& name) const;  ///< /iot/topologies/<name>
  std::string workers(const std::string& topology) const;
  std::string topology_order(const std::string& topology) const;  ///< /iot/topologies/<name>/wanted
  /// Below it each worker that was killed leaves a persistent node of its name: empty, or why it did not drain.
  std::string ended_workers(const std::string& topology) const;
  /// Who reads a driver's channel as one group, and who of them reads what: /iot/groups/<group>/<driver>/<channel>.
  std::string readers(const std::string& group, const std::string& driver, const std::string& channel) const;
  std::string sensors, gateways, topologies, groups;
};

/// A new instance id: a random UUID without dashes.
std::string new_instance_id();

}  // namespace iotcloud::discovery
