#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <utility>

#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/state/key_value_state.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// A bolt that remembers (Storm's IStatefulBolt). It acks and fails by its collector as any bolt; its acks are held
/// back until a checkpoint has made durable what the tuples changed, and become fails when the checkpoint fails. Ticks
/// make the checkpoints and are not seen by execute.
class StatefulBolt {
 public:
  virtual ~StatefulBolt() = default;
  virtual void declare_output_fields(OutputFieldsDeclarer& declarer) const { (void)declarer; }
  /// `context` and `collector` live until after cleanup().
  virtual void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) = 0;
  /// After prepare(): what the last checkpoint left, of an earlier process too. `state` lives until after cleanup().
  virtual void init_state(KeyValueState& state) = 0;
  virtual void execute(const Tuple& tuple) = 0;
  /// Before a checkpoint: the last moment to put what was collected outside of the state.
  virtual void pre_checkpoint() {}
  /// A checkpoint failed: the state is that of the checkpoint before, and what was kept beside it must be too.
  virtual void rolled_back() {}
  virtual void cleanup() {}
};

struct StateOptions {
  std::string store{};                         ///< as for make_state_store(); conf `state.store`
  std::chrono::milliseconds checkpoint{1000};  ///< period; conf `state.checkpoint`
};

/// Runs a stateful bolt as a Bolt.
std::unique_ptr<Bolt> run_stateful(std::unique_ptr<StatefulBolt> bolt, StateOptions options);

/// For TopologyBuilder::set_bolt. The configuration's `state.store` ("rocksdb:///var/lib/counts") and
/// `state.checkpoint`
/// ("500ms") take the place of the options. Options that cannot be used are refused by TopologyBuilder::build().
template <typename T, typename... Args>
BoltFactory make_stateful_bolt(StateOptions options = {}, Args... args) {
  return [options = std::move(options), args...] { return run_stateful(std::make_unique<T>(args...), options); };
}

}  // namespace iotcloud::topology
