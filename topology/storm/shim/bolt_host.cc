#include <algorithm>
#include <chrono>

#include <iotcloud/topology/runtime/tasks/pool.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>
#include <iotcloud/topology/storm/shim/bolt_host.h>
#include <iotcloud/topology/storm/value_format.h>

namespace iotcloud::topology::storm {

/// A tuple that Java handed over. Several threads may answer it, only the first answer counts.
struct BoltHost::Received final : detail::TupleData {
  using Objects = internal::Pool<Received>;

  void recycle() noexcept override {
    if (!answered.load(std::memory_order_acquire)) host->put(Answer::forget, slot);  // nobody else can answer it now
    values.clear();
    Objects::give(this);
  }

  BoltHost* host = nullptr;
  std::uint32_t slot = 0;
  std::size_t input = 0;
  bool java_has_values = false;       ///< while it keeps the tuple
  std::atomic<bool> answered{false};  ///< also of a tick, which Java does not keep
};

namespace {

/// Stands for Storm's tree of every tuple: senders to brokers ack a tuple without one before the broker confirms.
internal::Tree storms_tree;

/// A payload of so many bytes that a bolt passes on does not cross to Java again.
constexpr std::size_t least_kept = 256;

/// The place of the value that shares this payload's bytes; the number of values if none does.
std::size_t place_of(const Payload& payload, std::span<const Value> values) {
  const auto shares = [&](const Value& value) {
    const auto* other = std::get_if<Payload>(&value);
    return other != nullptr && other->data() == payload.data() && other->size() == payload.size();
  };
  return static_cast<std::size_t>(std::find_if(values.begin(), values.end(), shares) - values.begin());
}

std::chrono::microseconds shorter(std::chrono::microseconds a, std::chrono::microseconds b) {
  return a.count() == 0 ? b : b.count() == 0 ? a : std::min(a, b);
}

}  // namespace

BoltHost::BoltHost(const TaskDescription& task, Component component, std::span<std::byte> buffer, CommandSink& sink,
                   AnswerQueue& queue)
    : TaskHost(task, std::move(component), buffer, sink),
      queue_(queue),
      late_(counter("iotcloud_task_late_total", "Tuples older than their deadline, not executed")),
      superseded_(
          counter("iotcloud_task_superseded_total", "Tuples that a newer one of their key replaced (keep_last)")),
      execute_(clock_, histogram("iotcloud_task_execute_seconds", "One call of execute()")) {
  std::vector<internal::KeepLast> keep_last;
  streams_.reserve(task_.inputs.size());  // keep_last points to them
  for (const TaskDescription::Input& input : task_.inputs) {
    streams_.push_back({input.component, input.stream, input.fields});
    const auto same = [&](const InputSpec& given) {
      return given.from == input.component && given.stream == input.stream;
    };
    const auto given = std::find_if(spec_.inputs.begin(), spec_.inputs.end(), same);
    const auto own = given == spec_.inputs.end() ? std::chrono::microseconds(0) : given->deadline;
    deadlines_ns_.push_back(std::chrono::nanoseconds(shorter(spec_.deadline, own)).count());
    if (given == spec_.inputs.end() || given->keep_last == 0) continue;
    internal::KeepLast& keep = keep_last.emplace_back(internal::KeepLast{&streams_.back(), given->keep_last, {}});
    for (const std::string& field : given->keep_key.empty() ? given->fields : given->keep_key)
      keep.key.push_back(input.fields.find(field).value());  // build() checked that it is there
  }
  if (!keep_last.empty()) kept_ = std::make_unique<KeptTuples>(std::move(keep_last));
  bolt_ = spec_.bolt();
}

BoltHost::~BoltHost() {
  if (kept_) kept_->end();  // its tuples call this object
}

void BoltHost::open_component() {
  bolt_->prepare(spec_.config, context_, *this);
}

void BoltHost::close_component() {
  bolt_->cleanup();
}

std::size_t BoltHost::execute(std::uint32_t slot, std::size_t input, int source_task, HandedValues values) {
  Received* received = receive(slot, input, source_task);
  const Tuple tuple = Tuple::adopt(received);
  const OwnCall own(*this);
  if (guarded("execute()", [&] { fill(*received, input, values); })) {
    run(tuple, input);
  } else {
    answer(Answer::fail, tuple);
  }
  return commands_.take();
}

std::int64_t BoltHost::keep(std::uint32_t slot, std::size_t input, int source_task, HandedValues values) {
  Received* received = receive(slot, input, source_task);
  const Tuple tuple = Tuple::adopt(received);
  try {
    fill(*received, input, values);
    const Tuple replaced = kept_->put(tuple);
    if (!replaced) return -1;
    auto& its = static_cast<Received&>(*replaced.data());
    its.answered.store(true);
    superseded_.add();
    return its.slot;
  } catch (const std::exception& error) {
    report_error(error.what());
    answer(Answer::fail, tuple);
    return -1;
  }
}

BoltHost::Received* BoltHost::receive(std::uint32_t slot, std::size_t input, int source_task) {
  Received* received = Received::Objects::take();
  received->handles.store(1, std::memory_order_relaxed);
  received->host = this;
  received->slot = slot;
  received->input = input;
  received->answered.store(false, std::memory_order_relaxed);
  received->stream = &streams_[input];
  received->source_task = source_task;
  received->born_ns = 0;
  received->tree = &storms_tree;
  return received;
}

void BoltHost::fill(Received& received, std::size_t input, HandedValues& values) const {
  const bool births = task_.inputs[input].births;
  std::int64_t born_ms = 0;
  received.java_has_values = values.parcel == nullptr;
  if (values.parcel) {
    received.values.fill(values.parcel->values);
    born_ms = values.parcel->born_ms.value_or(0);
  } else {
    received.values = decode_values(values.bytes, births ? &born_ms : nullptr, values.arrays);
  }
  if (births) received.born_ns = birth_of(born_ms);
}

void BoltHost::run(const Tuple& tuple, std::size_t input) {
  const auto& received = static_cast<const Received&>(*tuple.data());
  current_ = &received;
  const bool done = guarded("execute()", [&] {
    if (late(received, input)) {
      give_up_late(tuple);
    } else {
      execute_.time([&] { bolt_->execute(tuple); });
    }
  });
  if (!done) answer(Answer::fail, tuple);
  current_ = nullptr;
}

std::int64_t BoltHost::run_next() {
  const KeptTuples::Next next = kept_->next();
  const OwnCall own(*this);
  write_answers();
  if (next.tick) run_tick();
  if (next.tuple) {
    const auto& received = static_cast<const Received&>(*next.tuple.data());
    commands_.executes(received.slot);
    run(next.tuple, received.input);
  }
  return next.end ? -1 : static_cast<std::int64_t>(commands_.take());
}

bool BoltHost::late(const Received& tuple, std::size_t input) const {
  const std::int64_t deadline_ns = deadlines_ns_[input];
  return deadline_ns > 0 && tuple.born_ns != 0 && clock_.now().time_since_epoch().count() - tuple.born_ns > deadline_ns;
}

void BoltHost::give_up_late(const Tuple& tuple) {
  late_.add();
  if (!spec_.late_stream.empty()) do_emit(spec_.late_stream, {&tuple, 1}, Values(tuple.data()->values), no_task);
  answer(Answer::ack, tuple);
}

std::size_t BoltHost::tick() {
  const OwnCall own(*this);
  run_tick();
  return commands_.take();
}

void BoltHost::run_tick() {
  Received* received = Received::Objects::take();
  received->handles.store(1, std::memory_order_relaxed);
  received->host = this;
  received->answered.store(true, std::memory_order_relaxed);
  received->stream = &tick_stream_;
  received->source_task = 0;
  received->tree = nullptr;
  received->born_ns = 0;
  const Tuple tuple = Tuple::adopt(received);
  guarded("execute() of a tick", [&] { bolt_->execute(tuple); });
}

std::size_t BoltHost::take_answers() {
  const OwnCall own(*this);
  write_answers();
  return commands_.take();
}

void BoltHost::write_answers() {
  std::vector<std::pair<Answer, std::uint32_t>> answers;
  std::vector<std::string> errors;
  {
    const config::MutexLock lock(mutex_);
    answers.swap(answers_);
    errors.swap(errors_);
  }
  for (const auto& [answer, slot] : answers) write(answer, slot);
  for (const std::string& error : errors) commands_.error(error);
}

std::chrono::microseconds BoltHost::own_tick_period() const {
  const bool whole = spec_.tick % std::chrono::seconds(1) == std::chrono::seconds(0);
  return whole && !task_.file.empty() ? std::chrono::microseconds(0) : spec_.tick;
}

// The collector.

void BoltHost::do_emit(std::string_view stream, std::span<const Tuple> anchors, Values&& values, int task) {
  require_own_call();
  const std::uint16_t number = checked_stream(stream, values, task);
  anchors_.clear();
  for (const Tuple& anchor : anchors) {
    const auto& received = static_cast<const Received&>(*anchor.data());
    if (!received.answered.load(std::memory_order_relaxed)) anchors_.push_back(received.slot);
  }
  const std::int64_t born_ns = birth_of_child(anchors);
  if (ParcelPtr parcel = pack(number, values, born_ns)) {
    commands_.emit(number, task, anchors_, std::move(parcel), task_.outputs[number].told);
    return;
  }
  find_kept(anchors, values.all());
  add_birth(number, values, born_ns);
  commands_.emit(number, task, anchors_, values.all(), kept_values_);
}

void BoltHost::find_kept(std::span<const Tuple> anchors, std::span<const Value> values) {
  kept_values_.clear();
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto* payload = std::get_if<Payload>(&values[i]);
    if (payload == nullptr || payload->size() < least_kept) continue;
    const auto look_in = [&](const Received& received) {
      if (!received.java_has_values || received.answered.load()) return false;
      const std::size_t place = place_of(*payload, received.values.all());
      if (place == received.values.size()) return false;
      kept_values_.resize(i + 1);
      kept_values_[i] = JavaValue{received.slot, static_cast<std::uint32_t>(place)};
      return true;
    };
    if (current_ != nullptr && look_in(*current_)) continue;
    for (const Tuple& anchor : anchors) {
      if (look_in(static_cast<const Received&>(*anchor.data()))) break;
    }
  }
}

std::int64_t BoltHost::birth_of_child(std::span<const Tuple> anchors) const {
  std::int64_t oldest = 0;
  for (const Tuple& anchor : anchors) {
    const std::int64_t born = anchor.data()->born_ns;
    if (born != 0 && (oldest == 0 || born < oldest)) oldest = born;
  }
  return oldest == 0 && current_ != nullptr ? current_->born_ns : oldest;
}

void BoltHost::answer(Answer answer, const Tuple& tuple) {
  if (!tuple) return;
  auto& received = static_cast<Received&>(*tuple.data());
  if (answer == Answer::reset ? received.answered.load() : received.answered.exchange(true)) return;
  put(answer, received.slot);
}

void BoltHost::put(Answer answer, std::uint32_t slot) {
  if (OwnCall::is_of(*this)) {
    write(answer, slot);
    return;
  }
  bool first = false;
  {
    const config::MutexLock lock(mutex_);
    first = answers_.empty() && errors_.empty();
    answers_.emplace_back(answer, slot);
  }
  if (first) tell();
}

void BoltHost::tell() {
  if (kept_) {
    kept_->wake();
  } else {
    queue_.put(*this);
  }
}

void BoltHost::write(Answer answer, std::uint32_t slot) {
  switch (answer) {
    case Answer::ack:
      return commands_.ack(slot);
    case Answer::fail:
      return commands_.fail(slot);
    case Answer::reset:
      return commands_.reset_timeout(slot);
    case Answer::forget:
      return commands_.forget(slot);
  }
}

void BoltHost::report_error(const std::string& text) {
  if (OwnCall::is_of(*this)) {
    commands_.error(text);
    return;
  }
  bool first = false;
  {
    const config::MutexLock lock(mutex_);
    first = answers_.empty() && errors_.empty();
    errors_.push_back(text);
  }
  if (first) tell();
}

}  // namespace iotcloud::topology::storm
