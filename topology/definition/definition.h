#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// What a field of a spout or bolt that faces a broker stands for (REFERENCE.md 5).
enum class FieldRole {
  payload,    ///< the message's bytes
  driver_id,  ///< "driverID", or the older "sensorID": the driver instance that sent it or is to get it
  time,       ///< "time": milliseconds since 1970 UTC, carried from the message in to the message out
};

/// How the payload stands in the tuple (`builder`).
enum class PayloadForm {
  bytes,  ///< a spout emits a Payload; a bolt takes a Payload or a string
  text,   ///< a spout emits a string; a bolt writes whatever value it gets as text
};

/// Properties of a spout that reads a broker.
struct ReadingOptions {
  bool automatic_ack = false;  ///< ackMode: auto = done when taken, manual = done when the tuple tree completed
  int prefetch = 100;          ///< prefetchCount: unsettled messages under way for each channel
  bool requeue = true;         ///< a failed tuple is tried again, maxTries times in all, then given up
  int max_tries = 3;           ///< maxTries
  std::string dead_letter;     ///< deadLetter: the topic that takes what is given up; empty: it is rejected
  int keep_last = 0;           ///< keepLast: of what waits only the newest N are handed on; 0 = all
};

/// What a bolt does with a tuple for a driver that is not there.
enum class UnknownDriver { ack, fail };

/// When a bolt that sends acks a tuple.
enum class AckWhen {
  confirmed,  ///< the broker has the message
  accepted,   ///< the publisher has it
};

/// Properties of a bolt that sends to a broker.
struct SendingOptions {
  bool keep_newest = false;  ///< whenFull: keep_newest drops the oldest that waits; block holds tuples back
  int capacity = 1024;       ///< messages that may wait for the broker, for each channel
  std::chrono::milliseconds deadline{0};              ///< older messages are worthless; 0 = none
  UnknownDriver unknown_driver = UnknownDriver::ack;  ///< unknownDriver; counted either way
  AckWhen ack_when = AckWhen::confirmed;              ///< ackWhen; accepted with keep_newest, unless it says otherwise
};

/// A spout or bolt that faces brokers: the paper's keys.
struct EndpointDefinition {
  std::string broker;  ///< the logical name that gateways know it by ("rabbitmq")
  std::string driver;
  std::string channel;
  discovery::Selection where;  ///< of the driver's instances these, at any time
  Fields fields;
  std::vector<FieldRole> roles;  ///< one for each field; exactly one payload
  PayloadForm form = PayloadForm::bytes;
  std::string stream = default_stream;  ///< spouts: what they emit to
  std::string group;                    ///< spouts: shares its messages with others of this group; empty: with nobody
  ReadingOptions reading;               ///< spouts
  SendingOptions sending;               ///< bolts
};

struct InputDefinition {
  std::string from;
  std::string stream = default_stream;
  std::string grouping;                   ///< one of grouping_names(), or "custom"
  std::string grouping_class;             ///< custom: a Grouping of a component library
  Fields fields;                          ///< key, of fields and partial_key
  std::chrono::microseconds deadline{0};  ///< Subscription::deadline
  std::size_t keep_last = 0;              ///< Subscription::keep_last
  Fields keep_key;                        ///< Subscription::keep_key
  config::Section section;                ///< where it stands
};

/// One entry of `spouts` or `bolts`: either an endpoint or a class of a component library.
struct ComponentDefinition {
  std::string id;
  std::optional<EndpointDefinition> endpoint;
  std::string class_name;  ///< empty: an endpoint
  int parallelism = 1;
  int tasks = 1;  ///< at least `parallelism`
  Config conf;
  std::optional<std::size_t> max_spout_pending;  ///< spouts; 0 = no limit, none = RunSettings'
  std::chrono::microseconds tick{0};             ///< bolts
  std::chrono::microseconds deadline{0};         ///< bolts: ComponentSpec::deadline
  std::string late_stream;                       ///< bolts, with a deadline
  bool worker_scope = false;                     ///< bolts: `scope: worker`, each worker for itself is meant
  std::vector<InputDefinition> inputs;           ///< bolts
  config::Section section;                       ///< where it stands
};

/// Settings of the run (`runtime`).
struct RunSettings {
  int threads = 0;  ///< 0: as many as the machine has
  std::chrono::milliseconds message_timeout{30000};
  bool acking = true;         ///< false: Storm's "0 ackers", a tuple counts as done when it is emitted
  int max_spout_pending = 0;  ///< tuples under way for each task of a spout; 0: the runtime's default
  int mailbox_capacity = 0;   ///< tuples that wait for a task; 0: the runtime's default
};

/// A topology's YAML file, read strictly (REFERENCE.md 5; keys in README.md). Only the file itself is checked here;
/// assemble() checks the graph.
struct TopologyDefinition {
  /// \throws config::ConfigError with file, line, column, key and what would be right.
  static TopologyDefinition load(const std::string& file);
  /// \param name stands for the file in messages.
  static TopologyDefinition parse(std::string_view text, const std::string& name);

  std::string file;
  std::string name;
  discovery::RegistryOptions registry;  ///< URL of `registry`, or made of zk.servers; empty: none given
  std::string zk_root;                  ///< zk.root
  bool worker_scope = false;            ///< `topology.scope: worker`: the bolts' worker_scope, for all
  std::vector<std::string> libraries;
  std::map<std::string, brokers::BrokerOptions> brokers;  ///< by logical name; URLs: instead of the gateways'
  Config conf;
  RunSettings runtime;
  std::string metrics_address;  ///< host:port of the metrics page; empty: none
  std::vector<ComponentDefinition> spouts;
  std::vector<ComponentDefinition> bolts;
  config::Section root;
};

}  // namespace iotcloud::topology
