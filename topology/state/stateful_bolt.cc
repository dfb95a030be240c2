#include <algorithm>
#include <deque>
#include <optional>
#include <stdexcept>
#include <vector>

#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/config/yaml/duration.h>
#include <iotcloud/topology/conf_keys.h>
#include <iotcloud/topology/grouping.h>
#include <iotcloud/topology/state/stateful_bolt.h>

namespace iotcloud::topology {

namespace {

const config::Logger state_logger{"topology.state"};

/// Of the bytes of a state.
constexpr std::chrono::seconds between_measurements{5};

void read_store(ConfCheck&, const std::string&, const std::string& text, StateOptions& options) {
  options.store = text;
}

void read_checkpoint(ConfCheck& check, const std::string& key, const std::string& text, StateOptions& options) {
  const auto duration = config::parse_duration(text);
  if (!duration || *duration < std::chrono::milliseconds(1)) {
    check.refuse(key, "\"" + text + "\" is no period; write a number and a unit, 1ms or more: 500ms, 2s, 1m");
  } else {
    options.checkpoint = std::chrono::duration_cast<std::chrono::milliseconds>(*duration);
  }
}

void read_keys(ConfCheck& check, const std::string& key, const std::string& text, StateOptions& options) {
  options.keys_of_grouping = text == "grouping";
  if (options.keys_of_grouping) return;
  check.refuse(key, "\"" + text +
                        "\" is nothing that keys can be; write \"grouping\" if each key is the text of the "
                        "field by which the inputs are grouped, or leave it out");
}

const std::vector<ConfOption<StateOptions>>& declared() {
  static const std::vector<ConfOption<StateOptions>> all{
      {{"state.store", "`memory://NAME`, `rocksdb:///PATH`, `redis://HOST:PORT` or `rediss://`",
        "the library's; one of both must say it",
        "where checkpoints go; of several systems (registries) that use one Redis each adds `?prefix=NAME`, a name of "
        "its own; with `rediss://` also `revoked_file=FILE`, a copy of revoked.pem, from `iotcloud certs revoke`: a "
        "server that is on it gets no password and no state"},
       read_store},
      {{"state.checkpoint", "duration, 1 ms at least",
        "the library's, else `" + config::internal::duration_text(StateOptions{}.checkpoint) + "`",
        "how often; acks wait for it"},
       read_checkpoint},
      {{"state.keys", "`grouping`", "the library's, else nothing is said",
        "each key is the text of the one field by which all inputs are grouped, so that the number of tasks may "
        "change"},
       read_keys}};
  return all;
}

StateOptions configured(StateOptions options, const Config& config) {
  ConfCheck check;
  check.read(config, "state.", declared(), options);
  check.finish();
  if (options.store.empty()) {
    throw std::invalid_argument(
        "a stateful bolt needs a store (StateOptions::store, or conf state.store): "
        "memory://NAME, rocksdb:///path or redis://HOST:PORT");
  }
  if (options.checkpoint.count() <= 0) throw std::invalid_argument("the period of checkpoints must be more than zero");
  return options;
}

bool is_grouped_by_fields(const TopologyContext& context) {
  return !context.input_keys.empty() && std::none_of(context.input_keys.begin(), context.input_keys.end(),
                                                     [](const Fields& key) { return key.empty(); });
}

/// Which task uses a key; empty: nothing says it. \throws std::invalid_argument for `state.keys: grouping` with another
/// grouping
StateOwner::TaskOf task_of(const StatefulBolt& bolt, const StateOptions& options, const TopologyContext& context) {
  if (options.keys_of_grouping) {
    const bool by_one_field =
        is_grouped_by_fields(context) && std::all_of(context.input_keys.begin(), context.input_keys.end(),
                                                     [](const Fields& key) { return key.size() == 1; });
    if (!by_one_field) {
      throw std::invalid_argument(
          "state.keys: grouping says that each key is the text of the field by which the inputs are grouped, but not "
          "all inputs have the grouping fields with one field; leave state.keys out, or change the grouping");
    }
    return [](std::string_view key, std::size_t tasks) { return task_of_key(Values(std::string(key)), tasks); };
  }
  if (!is_grouped_by_fields(context)) return {};
  return [&bolt](std::string_view key, std::size_t tasks) -> std::optional<std::size_t> {
    const auto values = bolt.grouping_key(key);
    return values ? std::optional(task_of_key(*values, tasks)) : std::nullopt;
  };
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
  void retry(const Tuple& tuple) override { collector_.retry(tuple); }
  bool is_void(const Tuple& tuple) const override { return collector_.is_void(tuple); }
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

/// Another worker has messages whose changes are not written yet.
class MessagesMoved : public StateError {
 public:
  using StateError::StateError;
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
    context_ = &context;
    StateOwner owner{context.topology, context.component, context.task_index, context.task_count};
    owner.task_of = task_of(*bolt_, options, context);
    is_grouped_ = is_grouped_by_fields(context);
    state_.emplace(make_state_store(options.store), std::move(owner));
    bolt_->prepare(config, context, *holding_);
    bolt_->init_state(*state_);
    show_size();
  }

  void execute(const Tuple& tuple) override {
    if (tuple.is_tick()) {
      checkpoint();
      execute_waiting();
    } else if (!waiting_.empty() || !execute_now(tuple)) {
      waiting_.push_back(tuple);
    }
  }

  void cleanup() override {
    set_trouble({});
    bolt_->cleanup();
  }

 private:
  /// While it lives, the state takes only keys that this tuple may use.
  class OfOneTuple {
   public:
    OfOneTuple(StatefulBoltExecutor& of, const Tuple& tuple) : state_(*of.state_) {
      if (of.is_grouped_) state_.expect_group([&of, &tuple] { return of.group_of(tuple); });
    }
    ~OfOneTuple() { state_.expect_group({}); }
    OfOneTuple(const OfOneTuple&) = delete;
    OfOneTuple& operator=(const OfOneTuple&) = delete;

   private:
    KeyValueState& state_;
  };

  void checkpoint() {
    // Takes the acks before pre_checkpoint(): a tuple that another thread acks from here on waits for the next
    // checkpoint, because its change may not be in this one.
    const std::vector<Tuple> held = holding_->take();
    try {
      call_pre_checkpoint();
      require_own_messages();
      const bool changed = state_->changed();
      show_size();  // before the checkpoint: after it a shared store's keys are forgotten here
      state_->checkpoint();
      if (changed) {
        checkpoints_->add();
      }
      tell_back();
      tell_losses();
    } catch (const StateUnavailable& e) {
      tell_unavailable(e);
      holding_->put_back(held);
      for (const Tuple& tuple : held) collector_->reset_timeout(tuple);
      return;
    } catch (const StateError& e) {  // no tuple is to blame
      give_up(held, e.what(), &OutputCollector::retry);
      return;
    } catch (const std::exception& e) {
      give_up(held, e.what(), &OutputCollector::fail);
      return;
    } catch (...) {
      give_up(held, "something that is no std::exception", &OutputCollector::fail);
      return;
    }
    executed_.clear();
    for (const Tuple& tuple : held) collector_->ack(tuple);
  }

  /// Shows how large the state is. The bytes are added up now and then, because that reads the whole state.
  void show_size() {
    if (context_->holdings == nullptr) return;
    auto& shown = *context_->holdings;
    shown.state_entries.store(static_cast<std::int64_t>(state_->size()), std::memory_order_relaxed);
    const auto now = context_->clock->now();
    if (measured_ && now - *measured_ < between_measurements) return;
    measured_ = now;
    std::int64_t bytes = 0;
    for (const auto& [key, value] : state_->entries()) bytes += static_cast<std::int64_t>(key.size() + value.size());
    shown.state_bytes.store(bytes, std::memory_order_relaxed);
  }

  void call_pre_checkpoint() {
    state_->begin_call();
    try {
      bolt_->pre_checkpoint();
    } catch (const StateUnavailable&) {
      state_->undo_call();
      throw;
    }
  }

  /// With a shared store: makes sure that all that this checkpoint would write comes from messages that are still this
  /// worker's. Only now it is too late for another worker to be ahead unseen: a worker that gets one of these messages
  /// after this moment claims its keys after this task, so that the store refuses this checkpoint. \throws
  /// MessagesMoved
  void require_own_messages() const {
    if (!state_->shared()) return;
    const auto moved = std::count_if(executed_.begin(), executed_.end(),
                                     [&](const Tuple& tuple) { return collector_->is_void(tuple); });
    if (moved == 0) return;
    throw MessagesMoved("the messages of " + std::to_string(moved) + " of " + std::to_string(executed_.size()) +
                        " tuples are another worker's now; nothing was written");
  }

  /// \return false if the store is away: the tuple has changed nothing, and must wait
  bool execute_now(const Tuple& tuple) {
    if (state_->shared() && collector_->is_void(tuple)) {
      collector_->retry(tuple);  // it would claim a key that another worker has claimed for this very message
      return true;
    }
    state_->begin_call();
    const OfOneTuple group(*this, tuple);
    try {
      bolt_->execute(tuple);
    } catch (const StateUnavailable& e) {
      state_->undo_call();
      holding_->forget(tuple);
      tell_unavailable(e);
      return false;
    }
    if (tuple.data()->tree != nullptr) executed_.push_back(tuple);
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
    const std::string text = "tuples wait for the state store, and nothing is acked: " + std::string(why.what());
    set_trouble(text);
    if (std::exchange(said_unavailable_, true)) return;
    collector_->report_error(text);
  }

  void set_trouble(const std::string& text) {
    if (std::exchange(trouble_, text) == text) return;
    context_->troubles->set(context_->component, std::to_string(context_->task), text);
  }

  /// The group (KeyValueState::groups) of the fields by which the tuple came here.
  std::size_t group_of(const Tuple& tuple) const {
    for (std::size_t i = 0; i < context_->inputs.size(); ++i) {
      const auto& [component, stream] = context_->inputs[i];
      if (tuple.source_component() != component || tuple.source_stream() != stream) continue;
      Values key;
      for (const std::string& field : context_->input_keys[i]) key.add(tuple.at(field));
      return task_of_key(key, KeyValueState::groups);
    }
    throw std::logic_error("a tuple came from \"" + tuple.source_component() + "\", which is no input");
  }

  /// Logs that the store is back. Called when the store has answered, and not after each tuple: a tuple that needs only
  /// keys that the task has read already is executed while the store is away, too.
  void tell_back() {
    set_trouble({});
    if (!std::exchange(said_unavailable_, false)) return;
    state_logger.info("{}: the state store is back", name_);
  }

  void tell_losses() {
    for (const std::string& loss : state_->take_losses()) {
      losses_->add();
      collector_->report_error(loss);
    }
  }

  /// Undoes all since the last checkpoint, and fails its tuples, also those that the bolt has not acked yet: their
  /// changes are undone.
  void give_up(const std::vector<Tuple>& held, const std::string& why, void (OutputCollector::*fail)(const Tuple&)) {
    failures_->add();
    state_->roll_back();
    for (const Tuple& tuple : held) (collector_->*fail)(tuple);
    for (const Tuple& tuple : std::exchange(executed_, {})) (collector_->*fail)(tuple);
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
  std::deque<Tuple> waiting_;    ///< for a store that is away
  std::vector<Tuple> executed_;  ///< tracked ones, since the last checkpoint
  const TopologyContext* context_ = nullptr;
  std::optional<config::Clock::Instant> measured_;  ///< when the bytes of the state were added up
  bool is_grouped_ = false;                         ///< the values of fields choose the task for all inputs
  std::string trouble_;                             ///< as context_->troubles has it
  bool said_unavailable_ = false;                   ///< the store is away, as far as is known, and that was said
};

}  // namespace

std::vector<ConfKey> state_conf_keys() {
  return keys_of(declared());
}

std::unique_ptr<Bolt> run_stateful(std::unique_ptr<StatefulBolt> bolt, StateOptions options) {
  return std::make_unique<StatefulBoltExecutor>(std::move(bolt), std::move(options));
}

}  // namespace iotcloud::topology
