#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/conf_keys.h>
#include <iotcloud/topology/state/key_value_state.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// A bolt whose state survives a restart (Storm's IStatefulBolt). It acks and fails through its collector as any bolt.
/// The runtime gets its acks only when a checkpoint has made the tuples' changes durable; if the checkpoint fails, the
/// tuples fail. Ticks trigger the checkpoints, and do not reach execute(). With a shared store, tuples whose messages
/// are another worker's now (OutputCollector::is_void()) do not reach it either.
class StatefulBolt {
 public:
  virtual ~StatefulBolt() = default;
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const { (void)declarer; }
  /// `context` and `collector` live until after cleanup().
  virtual void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) = 0;
  /// Called after prepare() with the state of the last checkpoint, perhaps of an earlier process. `state` lives until
  /// after cleanup().
  virtual void init_state(KeyValueState& state) = 0;
  /// Which tuples use a key of the state: the values of the fields by which the bolt's inputs are grouped (grouping
  /// `fields`), in the order of these fields, and of the same kinds; nullopt: that is not known. If all keys are known,
  /// the number of tasks may change: each key then goes to the task that gets these tuples. execute() may put only keys
  /// of its tuple, if they are known. It says the same at any time, also before prepare(), and changes nothing. Redis
  /// does not need it.
  virtual std::optional<Values> grouping_key(std::string_view key) const {
    (void)key;
    return std::nullopt;
  }
  /// With a shared store (Redis) the state's functions throw StateUnavailable while the store is away. Let it pass: the
  /// state is put back as it was before this call, and the tuple is executed again, and not acked or failed before. So
  /// use the state before you ack the tuple.
  virtual void execute(const Tuple& tuple) = 0;
  /// Called before a checkpoint: the last moment to put data into the state that the bolt keeps outside of it. As in
  /// execute(), let StateUnavailable pass: the state is put back as it was before this call, which is made again later.
  /// So forget such data only at the end of the call.
  virtual void pre_checkpoint() {}
  /// Called after a failed checkpoint. The state is that of the checkpoint before it; data that the bolt keeps outside
  /// of the state must be set back too.
  virtual void rolled_back() {}
  virtual void cleanup() {}
};

/// Where a stateful bolt keeps its state, and how often it writes it. Keys of the configuration override these.
struct StateOptions {
  std::string store{};                         ///< URL for make_state_store(); key `state.store`
  std::chrono::milliseconds checkpoint{1000};  ///< period of checkpoints; key `state.checkpoint`
  /// Each key is the text of the one field by which all inputs are grouped, so that StatefulBolt::grouping_key need not
  /// say it; key `state.keys: grouping`
  bool keys_of_grouping = false;
};

/// The keys of `conf` that override the options, all of which begin with `state.`.
std::vector<ConfKey> state_conf_keys();

/// Wraps a stateful bolt as a Bolt.
std::unique_ptr<Bolt> run_stateful(std::unique_ptr<StatefulBolt> bolt, StateOptions options);

/// For TopologyBuilder::set_bolt. The configuration overrides the options, see state_conf_keys().
/// TopologyBuilder::build() refuses unusable options.
template <typename T, typename... Args>
BoltFactory make_stateful_bolt(StateOptions options = {}, Args... args) {
  return [options = std::move(options), args...] { return run_stateful(std::make_unique<T>(args...), options); };
}

}  // namespace iotcloud::topology
