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

/// A graph that cannot run. `component` is the one to mend; empty: the whole.
class TopologyError : public config::Error {
 public:
  TopologyError(std::string component, const std::string& text) : Error(text), component_(std::move(component)) {}
  const std::string& component() const { return component_; }

 private:
  std::string component_;
};

/// One input of a bolt.
struct Subscription {
  std::string from;
  std::string stream = default_stream;
  std::string grouping;                   ///< name, for messages and listings
  Fields fields;                          ///< key, of fields and partial_key
  GroupingFactory factory;                ///< empty: direct
  std::chrono::microseconds deadline{0};  ///< as ComponentSpec::deadline, for this input; the shorter one counts
  std::size_t keep_last = 0;  ///< of what waits for a task only the newest so many of each key stay; 0 = all
  Fields keep_key;            ///< the key of keep_last; empty: `fields`, or the whole input without those
};

/// One component as it was set.
struct ComponentSpec {
  std::string id;
  SpoutFactory spout;  ///< exactly one of the two
  BoltFactory bolt;
  int parallelism = 1;  ///< executors: how many of the tasks may run at the same time; may change while it runs
  int tasks = 1;        ///< objects of the user's class, fixed; at least `parallelism`
  Config config;
  std::chrono::microseconds tick{0};  ///< bolts: period of tick tuples; 0 = none
  /// Bolts: a tuple whose spout emitted the root of its tree longer ago than this is not executed, but counted and
  /// acked; with `late_stream` it is emitted there, anchored. 0 = none.
  std::chrono::microseconds deadline{0};
  std::string late_stream;  ///< declared by build() with the fields of the inputs, which must agree
  std::optional<std::size_t> max_spout_pending;  ///< spouts: tracked tuples under way for each task; else the runtime's
  std::vector<Subscription> inputs;
};

struct StreamSpec {
  Fields fields;
  bool direct = false;
};

/// A checked graph. Immutable.
struct Topology {
  std::string name;
  Config config;
  std::vector<ComponentSpec> components;                             ///< sources before those they feed
  std::map<std::string, std::map<std::string, StreamSpec>> streams;  ///< by component and stream
};

/// Says where a bolt's tuples come from. Valid as long as the builder.
class BoltDeclarer {
 public:
  explicit BoltDeclarer(ComponentSpec& spec) : spec_(spec) {}
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
  /// By name, as in YAML (grouping_names(), "direct").
  BoltDeclarer& grouping(const std::string& name, const std::string& from, Fields key, const std::string& stream);
  BoltDeclarer& tick(std::chrono::microseconds period);
  /// \throws TopologyError when there would be less tasks than the parallelism.
  BoltDeclarer& tasks(int count);
  /// For all inputs of this bolt (ComponentSpec::deadline). \param late_stream empty: late tuples are dropped.
  BoltDeclarer& deadline(std::chrono::microseconds age, std::string late_stream = {});
  /// For the input that was added last. \throws TopologyError when there is none.
  BoltDeclarer& input_deadline(std::chrono::microseconds age);
  /// For the input that was added last: of the tuples that wait for a task only the newest `count` of each key stay, a
  /// newer one takes the place of the oldest, which is counted and acked. \param key empty: the grouping's own key, or
  /// one key for all. \throws TopologyError when there is no input.
  BoltDeclarer& keep_last(std::size_t count = 1, Fields key = {});

 private:
  ComponentSpec& spec_;
};

/// Valid as long as the builder.
class SpoutDeclarer {
 public:
  explicit SpoutDeclarer(ComponentSpec& spec) : spec_(spec) {}
  /// \throws TopologyError when there would be less tasks than the parallelism.
  SpoutDeclarer& tasks(int count);
  /// Tracked tuples under way for each task; 0 = no limit.
  SpoutDeclarer& max_pending(std::size_t count);

 private:
  ComponentSpec& spec_;
};

/// Puts a topology together. Not thread safe.
class TopologyBuilder {
 public:
  /// \param factory makes one object for each task, and one more for build() to ask for its fields.
  /// \throws TopologyError for an id that is taken or reserved ("__..."), or parallelism < 1.
  SpoutDeclarer set_spout(const std::string& id, SpoutFactory factory, int parallelism = 1, Config config = {});
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
  /// The declarer of a bolt that was set before (the application connects what YAML declared).
  /// \throws TopologyError when there is none of that id.
  BoltDeclarer bolt(const std::string& id);
  bool has(const std::string& id) const;

  /// Checks the graph. \throws TopologyError: an unknown source or stream, a key field that the source does not
  /// declare, a bolt without input, no spout, a cycle (named).
  Topology build(const std::string& name, const Config& config = {}) const;

 private:
  ComponentSpec& add(const std::string& id, int parallelism, Config config);
  std::vector<std::unique_ptr<ComponentSpec>> components_;
};

}  // namespace iotcloud::topology
