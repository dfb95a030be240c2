#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/rpc/http/page_settings.h>
#include <iotcloud/topology/definition/storm_settings.h>
#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/message_builder.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// The meanings of a field of a spout or bolt that faces a broker (docs/wire.md#topology-files).
enum class FieldRole {
  payload,      ///< the message's bytes, or what a builder makes of them
  driver_id,    ///< "driverID", or the older "sensorID": the driver instance that sent the message or shall get it
  time,         ///< "time": milliseconds since 1970 UTC, copied from the incoming to the outgoing message
  gateway_id,   ///< "gatewayID", or the older "siteID"; spouts
  channel,      ///< "channel": the channel's name; spouts
  redelivered,  ///< "redelivered": a bool, whether somebody may have had the message before; spouts
  property,     ///< {property: NAME}: a custom property of the message; null if the message has none
};

/// The converter between the payload and the fields (`builder`).
enum class PayloadForm {
  bytes,  ///< a spout emits a Payload; a bolt takes a Payload or a string
  text,   ///< a spout emits a string; a bolt writes any value as text
  built,  ///< a MessageBuilder does: `json`, or a class of a component library
};

/// Properties of a spout that reads from a broker.
struct ReadingOptions {
  bool automatic_ack = false;  ///< ackMode: auto acks a message when it is taken, manual when its tuple tree is done
  int prefetch = 100;          ///< prefetchCount: the most unsettled messages of each channel
  bool own_prefetch = false;   ///< the file has prefetchCount: the spout does not raise it by itself
  bool requeue = true;         ///< a failed message is tried again, up to maxTries times in all, then given up
  int max_tries = 3;           ///< maxTries
  std::string dead_letter;     ///< deadLetter: the topic for messages that were given up; empty: they are rejected
  int keep_last = 0;           ///< keepLast: only the newest N waiting messages are emitted; 0: all
};

/// The policies of a bolt for a tuple to a driver that does not exist.
enum class UnknownDriver { ack, fail };

/// When a sending bolt acks a tuple.
enum class AckWhen {
  confirmed,  ///< when the broker has confirmed the message
  accepted,   ///< when the publisher has accepted the message
};

/// Properties of a bolt that sends to a broker.
struct SendingOptions {
  bool keep_newest = false;  ///< whenFull: keep_newest drops the oldest waiting message; block holds tuples back
  int capacity = 1024;       ///< the most messages of each channel that wait for the broker
  std::chrono::milliseconds deadline{0};              ///< messages older than this are dropped; 0: none
  UnknownDriver unknown_driver = UnknownDriver::ack;  ///< unknownDriver; both are counted
  AckWhen ack_when = AckWhen::confirmed;              ///< ackWhen; the default is `accepted` with keep_newest
};

/// A spout or bolt that uses a broker, with the keys of the paper.
struct EndpointDefinition {
  std::string broker;  ///< the logical broker, by the gateways' name ("rabbitmq")
  discovery::DriverName driver;
  std::string channel;
  discovery::Selection where;  ///< selects driver instances, also those that come later
  Fields fields;
  std::vector<FieldRole> roles;  ///< one for each field; exactly one payload, or at least one if the form is `built`
  std::vector<std::string> properties;  ///< one for each field: the name of the property, empty for other roles
  PayloadForm form = PayloadForm::bytes;
  std::string builder = "bytes";        ///< as the file has it
  MessageBuilderFactory make_builder;   ///< of a component library's class; assemble() sets it
  std::string stream = default_stream;  ///< spouts: the stream to which the spout emits
  std::string group;                    ///< spouts: all spouts of this group share the messages; empty: no sharing
  ReadingOptions reading;               ///< spouts
  SendingOptions sending;               ///< bolts
};

/// One of a bolt's `inputs`.
struct InputDefinition {
  std::string from;
  std::string stream = default_stream;
  std::string grouping;                   ///< one of grouping_names(), or "custom"
  std::string grouping_class;             ///< for "custom": the name of a Grouping in a component library
  Fields fields;                          ///< the key of the groupings `fields` and `partial_key`
  std::chrono::microseconds deadline{0};  ///< InputSpec::deadline
  std::size_t keep_last = 0;              ///< InputSpec::keep_last
  Fields keep_key;                        ///< InputSpec::keep_key
  config::YamlSection section;            ///< the input's place in the file
};

/// One entry of `spouts` or `bolts`: either an endpoint or a class of a component library.
struct ComponentDefinition {
  std::string id;
  std::optional<EndpointDefinition> endpoint;
  std::string class_name;  ///< empty for an endpoint
  int parallelism = 1;
  int tasks = 1;  ///< at least `parallelism`
  Config conf;
  std::optional<std::size_t> max_spout_pending;  ///< spouts; 0 = no limit, empty = that of RunSettings
  std::chrono::microseconds tick{0};             ///< bolts
  std::chrono::microseconds deadline{0};         ///< bolts: ComponentSpec::deadline
  std::string late_stream;                       ///< bolts: ComponentSpec::late_stream
  bool worker_scope = false;                     ///< bolts: `scope: worker`, each worker processes its own tuples only
  std::vector<InputDefinition> inputs;           ///< bolts
  config::YamlSection section;                   ///< the component's place in the file
};

/// Where the threads of the worker's process run (`runtime.placement`).
struct PlacementSettings {
  std::vector<int> cores = {};  ///< that they may use; empty: all
  int priority = 0;             ///< of SCHED_FIFO, 1 to 99; 0: the usual scheduler
  bool lock_memory = false;     ///< what they have touched is never paged out
};

/// Settings of the run (`runtime`).
struct RunSettings {
  int threads = 0;  ///< 0: one for each core
  std::chrono::milliseconds message_timeout{30000};
  bool acking = true;         ///< false: a spout's tuple counts as acked when it is emitted (Storm: "0 ackers")
  int max_spout_pending = 0;  ///< how many tuples each task of a spout may have under way; 0: the runtime's default
  int mailbox_capacity = 0;   ///< how many tuples a task's mailbox holds; 0: the runtime's default
  PlacementSettings placement;
};

/// The fields that a message's payload gives or takes.
Fields payload_fields(const EndpointDefinition& endpoint);
/// The builders that need no component library: "bytes", "text", "json".
const std::vector<std::string>& built_in_builders();

/// A topology's YAML file, read strictly (docs/wire.md#topology-files; keys in README.md). Only the file itself is
/// checked here; assemble() checks the graph.
struct TopologyDefinition {
  /// \throws config::ConfigError with file, line, column, key and what would be right.
  static TopologyDefinition load(const std::string& file);
  /// \param name stands for the file in messages.
  static TopologyDefinition parse(std::string_view text, const std::string& name);
  /// Reads a file's sections in YamlSection::all_errors(), so that what is checked afterwards adds to its errors. When
  /// there are errors, parts of what is returned are stand-ins.
  static TopologyDefinition read(config::YamlSection& root, const std::string& file);

  std::string file;
  discovery::TopologyName name;
  discovery::RegistryOptions registry;  ///< URL from `registry` or zk.servers; empty: the file names none
  std::string zk_root;                  ///< zk.root
  std::vector<std::string> order_keys;  ///< orders.trusted_keys: files or folders; empty: orders need no signature
  bool worker_scope = false;            ///< `topology.scope: worker` sets worker_scope of all bolts
  std::vector<std::string> libraries;
  std::map<std::string, brokers::BrokerOptions> brokers;  ///< by logical name; URLs here override those of the gateways
  Config conf;
  RunSettings runtime;
  StormSettings storm;
  rpc::PageSettings pages;  ///< of the worker; without an address it takes a free port of loopback
  std::vector<ComponentDefinition> spouts;
  std::vector<ComponentDefinition> bolts;
  config::YamlSection root;
};

}  // namespace iotcloud::topology
