#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/grouping.h>
#include <iotcloud/topology/spout.h>

namespace iotcloud::topology {

using SpoutFactory = std::function<std::unique_ptr<Spout>()>;
using BoltFactory = std::function<std::unique_ptr<Bolt>()>;

/// Says why a graph cannot run. component() is the component that must be changed; empty: the graph as a whole.
class TopologyError : public config::Error {
 public:
  TopologyError(std::string component, const std::string& text) : Error(text), component_(std::move(component)) {}
  const std::string& component() const { return component_; }

 private:
  std::string component_;
};

/// What a component says against its own settings when it is asked for its fields and ticks.
struct ComponentTrouble {
  std::string component;
  std::string conf_key;  ///< the key of its configuration; empty if it is not about one
  std::string text;
};

/// One input of a bolt.
struct InputSpec {
  std::string from;
  std::string stream = default_stream;
  std::string grouping;                   ///< the grouping's name, for error messages and listings
  Fields fields;                          ///< key of the groupings `fields` and `partial_key`
  GroupingFactory factory;                ///< makes the grouping; empty for `direct`
  std::chrono::microseconds deadline{0};  ///< as ComponentSpec::deadline, for this input only; the shorter one applies
  std::size_t keep_last = 0;  ///< a task's mailbox keeps only the newest N tuples of each key; 0: it keeps all
  Fields keep_key;            ///< key of keep_last; empty: `fields`; if that is empty too, all tuples have one key
};

/// A component and its settings.
struct ComponentSpec {
  std::string id;
  SpoutFactory spout;  ///< either spout or bolt is set
  BoltFactory bolt;
  int parallelism = 1;  ///< number of executors: how many tasks may run at the same time; Runtime::rebalance changes it
  int tasks = 1;        ///< number of objects of the user's class; fixed, at least `parallelism`
  Config config;
  std::chrono::microseconds tick{0};   ///< for bolts: period of tick tuples; 0: none
  std::chrono::microseconds holds{0};  ///< for bolts: Bolt::holds_tuples_for(); build() sets it
  /// For bolts. A tuple is late when its spout emitted the root of its tree longer ago than this. A task does not
  /// execute a late tuple: it counts it, emits it, anchored, to `late_stream` if that is set, and acks it. 0: no
  /// deadline.
  std::chrono::microseconds deadline{0};
  std::string late_stream;  ///< build() declares it with the fields of the inputs, which must all have the same
  /// For spouts: how many tracked tuples each task may have under way. Empty: RuntimeOptions::max_spout_pending.
  std::optional<std::size_t> max_spout_pending;
  std::vector<InputSpec> inputs;
};

/// A declared stream: the names of its fields, and whether the emitting component names the receiving tasks
/// (emit_direct).
struct StreamSpec {
  Fields fields;
  bool direct = false;
};

/// A graph that TopologyBuilder::build() has checked.
struct Topology {
  std::string name;
  Config config;
  std::vector<ComponentSpec> components;                             ///< sources come before the bolts that they feed
  std::map<std::string, std::map<std::string, StreamSpec>> streams;  ///< by component and stream
};

/// Sets the inputs and settings of a bolt. Valid as long as the builder.
class BoltDeclarer {
 public:
  explicit BoltDeclarer(ComponentSpec& spec) : spec_(spec) {}
  // Each of these adds an input: the bolt gets the tuples of the stream `stream` of the component `from`, by the
  // grouping of that name (grouping_names() describes them).
  BoltDeclarer& shuffle_grouping(const std::string& from, const std::string& stream = default_stream);
  BoltDeclarer& fields_grouping(const std::string& from, Fields key, const std::string& stream = default_stream);
  BoltDeclarer& partial_key_grouping(const std::string& from, Fields key, const std::string& stream = default_stream);
  BoltDeclarer& all_grouping(const std::string& from, const std::string& stream = default_stream);
  BoltDeclarer& global_grouping(const std::string& from, const std::string& stream = default_stream);
  BoltDeclarer& none_grouping(const std::string& from, const std::string& stream = default_stream);
  BoltDeclarer& local_or_shuffle_grouping(const std::string& from, const std::string& stream = default_stream);
  BoltDeclarer& direct_grouping(const std::string& from, const std::string& stream = default_stream);
  BoltDeclarer& custom_grouping(const std::string& from, GroupingFactory factory,
                                const std::string& stream = default_stream);
  /// Adds an input by the grouping's name, as in YAML (grouping_names(), "direct").
  BoltDeclarer& grouping(const std::string& name, const std::string& from, Fields key, const std::string& stream);
  /// Sends each task a tick tuple every `period`.
  BoltDeclarer& tick(std::chrono::microseconds period);
  /// \throws TopologyError if there would be fewer tasks than executors.
  BoltDeclarer& tasks(int count);
  /// Sets the deadline of all inputs of this bolt (ComponentSpec::deadline). \param late_stream where late tuples are
  /// emitted; empty: they are dropped.
  BoltDeclarer& deadline(std::chrono::microseconds age, std::string late_stream = {});
  /// Sets the deadline of the input that was added last. \throws TopologyError if there is none.
  BoltDeclarer& input_deadline(std::chrono::microseconds age);
  /// Makes each task's mailbox keep only the newest `count` tuples of each key, of those that came by the input that
  /// was added last. A newer tuple replaces the oldest one, which is counted and acked. \param key empty: the
  /// grouping's key; if that is empty too, all tuples have one key. \throws TopologyError if there is no input.
  BoltDeclarer& keep_last(std::size_t count = 1, Fields key = {});

 private:
  ComponentSpec& spec_;
};

/// Sets a spout's settings. Valid as long as the builder.
class SpoutDeclarer {
 public:
  explicit SpoutDeclarer(ComponentSpec& spec) : spec_(spec) {}
  /// \throws TopologyError if there would be fewer tasks than executors.
  SpoutDeclarer& tasks(int count);
  /// Limits how many tracked tuples each task may have under way; 0: no limit.
  SpoutDeclarer& max_pending(std::size_t count);

 private:
  ComponentSpec& spec_;
};

/// Puts a topology together. Not thread safe.
class TopologyBuilder {
 public:
  /// \param factory makes one object for each task, and one more that build() asks for its streams.
  /// \throws TopologyError for an id that is taken or reserved ("__..."), or parallelism < 1.
  SpoutDeclarer set_spout(const std::string& id, SpoutFactory factory, int parallelism = 1, Config config = {});
  /// As set_spout(). Add the bolt's inputs to what it returns.
  BoltDeclarer set_bolt(const std::string& id, BoltFactory factory, int parallelism = 1, Config config = {});
  template <typename T>
  SpoutDeclarer set_spout(const std::string& id, int parallelism = 1, Config config = {}) {
    return set_spout(
        id, [] { return std::make_unique<T>(); }, parallelism, std::move(config));
  }
  template <typename T>
  BoltDeclarer set_bolt(const std::string& id, int parallelism = 1, Config config = {}) {
    return set_bolt(
        id, [] { return make_bolt<T>(); }, parallelism, std::move(config));
  }
  /// The declarer of a bolt that was set before; an application uses it to connect bolts that YAML declared.
  /// \throws TopologyError for an unknown id.
  BoltDeclarer bolt(const std::string& id);
  bool has(const std::string& id) const;

  /// Asks all components for their fields and ticks: what those say that refuse.
  std::vector<ComponentTrouble> troubles(const Config& config = {}) const;
  /// Checks the graph. \throws TopologyError for an unknown source or stream, a key field that the source does not
  /// declare, a bolt without input, a graph without spout, and a cycle (which it names).
  Topology build(const std::string& name, const Config& config = {}) const;

 private:
  ComponentSpec& add(const std::string& id, int parallelism, Config config);
  std::vector<std::unique_ptr<ComponentSpec>> components_;
};

}  // namespace iotcloud::topology
