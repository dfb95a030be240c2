#include <deque>
#include <optional>
#include <stdexcept>
#include <vector>

#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/topology/conf_keys.h>
#include <iotcloud/topology/state/stateful_bolt.h>

namespace iotcloud::topology {

namespace {

const config::Logger state_logger{"topology.state"};

StateOptions configured(StateOptions options, const Config& config) {
  ConfCheck check;
  check.refuse_unknown_keys(config, "state.", {"state.store", "state.checkpoint"});
  if (const auto store = config.find("state.store"); store != config.end()) options.store = store->second;
  if (const auto period = config.find("state.checkpoint"); period != config.end()) {
    const auto duration = config::parse_duration(period->second);
    if (!duration || *duration < std::chrono::milliseconds(1)) {
      check.refuse("state.checkpoint",
                   "\"" + period->second + "\" is no period; write a number and a unit, 1ms or more: 500ms, 2s, 1m");
    } else {
      options.checkpoint = std::chrono::duration_cast<std::chrono::milliseconds>(*duration);
    }
  }
  check.finish();
  if (options.store.empty()) {
    throw std::invalid_argument(
        "a stateful bolt needs a store (StateOptions::store, or conf state.store): "
        "memory://NAME, rocksdb:///path or redis://HOST:PORT");
  }
  if (options.checkpoint.count() <= 0) throw std::invalid_argument("the period of checkpoints must be more than zero");
  return options;
}

/// Holds acks back and passes on everything else.
class HoldingCollector final : public OutputCollector {
 public:
  explicit HoldingCollector(OutputCollector& collector) : collector_(collector) {}
  void ack(const Tuple& tuple) override {
    const config::MutexLock lock(mutex_);
    held_.push_back(tuple);
  }
  void fail(const Tuple& tuple) override { collector_.fail(tuple); }
  void reset_timeout(const Tuple& tuple) override { collector_.reset_timeout(tuple); }
  void report_error(const std::string& text) override { collector_.report_error(text); }
  /// Takes the tuples acked so far.
  std::vector<Tuple> take() {
    const config::MutexLock lock(mutex_);
    return std::exchange(held_, {});
  }
  /// Holds these again.
  void put_back(const std::vector<Tuple>& tuples) {
    const config::MutexLock lock(mutex_);
    held_.insert(held_.begin(), tuples.begin(), tuples.end());
  }
  /// Takes an ack back.
  void forget(const Tuple& tuple) {
    const config::MutexLock lock(mutex_);
    std::erase_if(held_, [&](const Tuple& held) { return held.data() == tuple.data(); });
  }

 protected:
  void do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) override {
    if (task == no_task) {
      collector_.emit_to(stream, anchors, std::move(values));
    } else {
      collector_.emit_direct(task, stream, anchors, std::move(values));
    }
  }

 private:
  OutputCollector& collector_;
  config::Mutex mutex_;
  std::vector<Tuple> held_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// Runs a StatefulBolt as a Bolt: holds its acks and makes the checkpoints, like Storm's StatefulBoltExecutor.
class StatefulBoltExecutor final : public Bolt {
 public:
  StatefulBoltExecutor(std::unique_ptr<StatefulBolt> bolt, StateOptions options)
      : bolt_(std::move(bolt)), options_(std::move(options)) {}

  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { bolt_->declare_output_fields(declarer); }
  std::chrono::microseconds tick_period(const Config& config) const override {
    return configured(options_, config).checkpoint;
  }
  std::chrono::microseconds holds_tuples_for(const Config& config) const override { return tick_period(config); }

  void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) override {
    const StateOptions options = configured(options_, config);
    const config::Labels labels{
        {"topology", context.topology}, {"component", context.component}, {"task", std::to_string(context.task)}};
    checkpoints_ = &context.metrics->counter("iotcloud_task_checkpoints_total", "Checkpoints made durable", labels);
    failures_ = &context.metrics->counter("iotcloud_task_checkpoint_failures_total", "Checkpoints that failed", labels);
    losses_ = &context.metrics->counter("iotcloud_task_state_losses_total",
                                        "Keys of which the state store has lost checkpoints", labels);
    collector_ = &collector;
    name_ = context.component + "#" + std::to_string(context.task);
    holding_.emplace(collector);
    state_.emplace(make_state_store(options.store),
                   StateOwner{context.topology, context.component, context.task_index, context.task_count});
    bolt_->prepare(config, context, *holding_);
    bolt_->init_state(*state_);
  }

  void execute(const Tuple& tuple) override {
    if (tuple.is_tick()) {
      checkpoint();
      execute_waiting();
    } else if (!waiting_.empty() || !execute_now(tuple)) {
      waiting_.push_back(tuple);
    }
  }

  void cleanup() override { bolt_->cleanup(); }

 private:
  void checkpoint() {
    // Takes the acks before pre_checkpoint(): a tuple that another thread acks from here on waits for the next
    // checkpoint, because its change may not be in this one.
    const std::vector<Tuple> held = holding_->take();
    try {
      bolt_->pre_checkpoint();
      const bool changed = state_->changed();
      state_->checkpoint();
      if (changed) {
        checkpoints_->add();
        tell_back();
      }
      tell_losses();
    } catch (const StateUnavailable& e) {
      tell_unavailable(e);
      holding_->put_back(held);
      for (const Tuple& tuple : held) collector_->reset_timeout(tuple);
      return;
    } catch (const std::exception& e) {
      give_up(held, e.what());
      return;
    } catch (...) {
      give_up(held, "something that is no std::exception");
      return;
    }
    for (const Tuple& tuple : held) collector_->ack(tuple);
  }

  /// \return false if the store is away: the tuple has changed nothing, and must wait
  bool execute_now(const Tuple& tuple) {
    state_->begin_call();
    try {
      bolt_->execute(tuple);
    } catch (const StateUnavailable& e) {
      state_->undo_call();
      holding_->forget(tuple);
      tell_unavailable(e);
      return false;
    }
    tell_losses();
    return true;
  }

  /// Executes the tuples that wait for the store, in order, as long as it is there.
  void execute_waiting() {
    while (!waiting_.empty() && execute_now(waiting_.front())) {
      waiting_.pop_front();
      tell_back();  // this tuple had to wait for the store, so the store has answered
    }
    for (const Tuple& tuple : waiting_) collector_->reset_timeout(tuple);
  }

  void tell_unavailable(const StateUnavailable& why) {
    if (std::exchange(said_unavailable_, true)) return;
    collector_->report_error("tuples wait for the state store, and nothing is acked: " + std::string(why.what()));
  }

  /// Logs that the store is back. Called when the store has answered, and not after each tuple: a tuple that needs only
  /// keys that the task has read already is executed while the store is away, too.
  void tell_back() {
    if (!std::exchange(said_unavailable_, false)) return;
    state_logger.info("{}: the state store is back", name_);
  }

  void tell_losses() {
    for (const std::string& loss : state_->take_losses()) {
      losses_->add();
      collector_->report_error(loss);
    }
  }

  void give_up(const std::vector<Tuple>& held, const std::string& why) {
    failures_->add();
    state_->roll_back();
    for (const Tuple& tuple : held) collector_->fail(tuple);
    collector_->report_error("a checkpoint failed, and the tuples since the last one with it: " + why);
    bolt_->rolled_back();
  }

  const std::unique_ptr<StatefulBolt> bolt_;
  const StateOptions options_;
  OutputCollector* collector_ = nullptr;
  std::string name_;  ///< for the log
  std::optional<HoldingCollector> holding_;
  std::optional<KeyValueState> state_;
  config::Counter* checkpoints_ = nullptr;
  config::Counter* failures_ = nullptr;
  config::Counter* losses_ = nullptr;
  std::deque<Tuple> waiting_;      ///< for a store that is away
  bool said_unavailable_ = false;  ///< the store is away, as far as is known, and that was said
};

}  // namespace

std::unique_ptr<Bolt> run_stateful(std::unique_ptr<StatefulBolt> bolt, StateOptions options) {
  return std::make_unique<StatefulBoltExecutor>(std::move(bolt), std::move(options));
}

}  // namespace iotcloud::topology
