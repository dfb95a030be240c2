#include <algorithm>
#include <stdexcept>

#include <fmt/format.h>

#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/message_fields.h>
#include <iotcloud/topology/endpoints/receiving/broker_spout.h>

namespace iotcloud::topology {

namespace {

/// How long a task that closes waits for the broker's confirmations of dead letters. A message whose letter is not
/// confirmed by then is delivered again, and the letter may exist as well.
constexpr std::chrono::milliseconds letters_limit{300};
/// Time between two lines in the log about messages that are given up.
constexpr std::chrono::seconds quiet_time{10};
/// Why a message is given up.
constexpr const char* tuple_failed = "the tuple failed or timed out";

/// The origin of a message that is followed.
class TracedOrigin final : public TupleOrigin {
 public:
  TracedOrigin(std::shared_ptr<const TupleOrigin> origin, std::shared_ptr<MessageTrace> trace)
      : origin_(std::move(origin)), trace_(std::move(trace)) {}
  bool comes_again() const override { return origin_->comes_again(); }
  TupleTrace* trace() const override { return trace_.get(); }

 private:
  const std::shared_ptr<const TupleOrigin> origin_;
  const std::shared_ptr<MessageTrace> trace_;
};

}  // namespace

void BrokerSpout::open(const Config&, const TopologyContext& context, SpoutOutputCollector& collector) {
  collector_ = &collector;
  component_ = context.component;
  const config::Labels labels{{"topology", context.topology}, {"component", context.component}};
  auto& metrics = *services_->metrics;
  received_ = &metrics.counter("iotcloud_spout_received_total", "Messages taken from brokers", labels);
  retried_ =
      &metrics.counter("iotcloud_spout_retried_total", "Messages whose tuple failed and was tried again", labels);
  rejected_ = &metrics.counter("iotcloud_spout_rejected_total", rejected_help, labels);
  unreadable_ = &metrics.counter("iotcloud_spout_unreadable_total",
                                 "Messages given up because their builder refused them", labels);
  if (endpoint_.make_builder) builder_ = endpoint_.make_builder();
  filter_.emplace(placement_->known_instances(), !endpoint_.where.everything(), metrics, labels);
  waker_ = context.waker;
  fence_count_ = services_->fence->count();
  queue_ = std::make_shared<SpoutQueue>(static_cast<std::size_t>(endpoint_.reading.prefetch), context.waker,
                                        services_->traces);
  placement_->join(context.task_index, context.task_count, queue_);
}

void BrokerSpout::close() {
  if (dead_letters_) dead_letters_->drain(letters_limit);
  placement_->leave();  // first: an open reader would get again at once what the closed queue gives back to the broker
  queue_->close();
  traced_.clear();
  slots_.clear();  // messages under way go back to the broker
  next_.reset();
  free_.clear();
  retries_.clear();
  if (filter_) filter_->clear();
}

bool BrokerSpout::next_tuple() {
  if (next_) {
    ChannelMessage arrival = std::move(*next_);
    next_.reset();
    if (!comes_again(arrival) && bring(std::move(arrival))) return true;
  }
  if (!retries_.empty()) {
    while (auto arrival = retries_.next(services_->clock->now())) {
      if (comes_again(*arrival)) {
        retries_.done(*arrival);
        continue;
      }
      emit(std::move(*arrival));
      return true;
    }
  }
  if (!filter_->empty()) {
    for (auto passed = filter_->next(services_->clock->now()); passed.arrival;
         passed = filter_->next(services_->clock->now())) {
      if (admit(std::move(passed))) return true;
    }
    if (filter_->full()) return false;
  }
  for (;;) {
    auto [arrival, more] = queue_->pop();
    if (!arrival) return false;
    note_arrival(*arrival);
    auto passed = filter_->pass(std::move(*arrival), services_->clock->now());
    if (!passed.arrival) {
      if (filter_->full()) return false;
    } else if (admit(std::move(passed))) {
      return more || next_;
    }
  }
}

void BrokerSpout::note_arrival(const ChannelMessage& arrival) {
  received_->add();
  const std::int64_t time = arrival.delivery.message.time_ms;
  // The device's clock may be ahead.
  if (time > 0) arrivals_->came(std::max<std::int64_t>(services_->clock->wall_ms() - time, 0));
}

/// Whether the message is the first that this spout sees after the fence was raised; true once for each time. Such a
/// message must wait for the next call of next_tuple(): a tuple's birth is when next_tuple() was called, and tuples
/// that were born before the fence was raised are void.
bool BrokerSpout::is_first_after_fence(const ChannelMessage& arrival) {
  return std::exchange(fence_count_, arrival.reader->fence_count()) != arrival.reader->fence_count();
}

/// Takes what the filter has let go, a message or one that it refuses. \return as bring().
bool BrokerSpout::admit(SenderFilter::Passed passed) {
  if (passed.refusal.empty()) return bring(std::move(*passed.arrival));
  if (!comes_again(*passed.arrival)) refuse(std::move(*passed.arrival), passed.refusal);
  return false;
}

/// Emits the message, or keeps it for later. \return true when next_tuple() must return: the message was emitted, or
/// waits for the next call. False: the message is void and dropped, or it waits in retries_ behind an earlier message
/// of its driver.
bool BrokerSpout::bring(ChannelMessage arrival) {
  if (arrival.reader->is_void()) return false;
  if (is_first_after_fence(arrival)) {
    next_ = std::move(arrival);
    return true;
  }
  arrival.sequence = ++last_sequence_;
  if (retries_.hold(arrival)) return false;
  emit(std::move(arrival));
  return true;
}

void BrokerSpout::emit(ChannelMessage arrival) {
  Values values;
  try {
    values = values_of(arrival);
  } catch (const std::exception& error) {
    unreadable_->add();
    ++arrival.tries;
    retries_.done(arrival);
    give_up(std::move(arrival), fmt::format("the builder {} cannot read it: {}", endpoint_.builder, error.what()));
    return;
  }
  if (endpoint_.reading.automatic_ack) {
    if (services_->traces->any()) {
      if (const auto trace = trace_of(arrival)) trace->done(services_->clock->now(), "not followed");
    }
    collector_->emit_to(endpoint_.stream, std::move(values));
    return;
  }
  ++arrival.tries;
  std::shared_ptr<const TupleOrigin> origin = arrival.reader.shared();
  const auto trace = services_->traces->any() ? trace_of(arrival) : nullptr;
  if (trace) origin = std::make_shared<TracedOrigin>(std::move(origin), trace);
  const MessageId id = keep(std::move(arrival));
  if (trace) traced_[id] = trace;
  collector_->emit_to(endpoint_.stream, std::move(values), id, std::move(origin));
}

std::shared_ptr<MessageTrace> BrokerSpout::trace_of(const ChannelMessage& arrival) {
  return services_->traces->take(arrival.delivery.message, arrival.reader->topic().name, component_, arrival.tries > 1);
}

/// Ends the trace of a message, if it has one. \param outcome empty: the message is tried again
void BrokerSpout::end_trace(MessageId id, const char* outcome) {
  const auto found = traced_.find(id);
  if (found == traced_.end()) return;
  if (*outcome != '\0') found->second->done(services_->clock->now(), outcome);
  traced_.erase(found);
}

std::chrono::microseconds BrokerSpout::poll_period() const {
  const auto due = retries_.due();
  const bool filtering = filter_ && !filter_->empty();
  if (!due) return std::chrono::microseconds(filtering ? SenderFilter::look_again : std::chrono::milliseconds{0});
  constexpr std::chrono::microseconds least = std::chrono::milliseconds(1);
  const auto now = services_->clock->now();
  if (*due <= now) return least;
  // The runtime cannot move a poll forward once it is planned. A message that fails meanwhile may be due before it, so
  // no poll is further away than the shortest pause of a retry.
  const std::chrono::microseconds most = filtering ? SenderFilter::look_again : Retries::pause_after(1);
  return std::clamp<std::chrono::microseconds>(std::chrono::ceil<std::chrono::microseconds>(*due - now), least,
                                               std::max(most, least));
}

void BrokerSpout::ack(MessageId id) {
  if (!traced_.empty()) end_trace(id, "acked");
  auto arrival = take(id);
  if (!arrival) return;
  arrival->delivery.settle(brokers::Settlement::accept);
  if (!arrival->blocks) return;
  retries_.done(*arrival);
  waker_.wake();
}

/// Whether the broker delivers the message again by itself, so that this spout must drop it.
bool BrokerSpout::comes_again(const ChannelMessage& arrival) {
  return arrival.reader->comes_again();
}

void BrokerSpout::fail(MessageId id) {
  auto arrival = take(id);
  if (!arrival) return;
  const bool again = endpoint_.reading.requeue && arrival->tries - arrival->excused < endpoint_.reading.max_tries;
  if (!traced_.empty()) end_trace(id, again ? "" : "given up");
  if (comes_again(*arrival)) {
    retries_.done(*arrival);
  } else if (again) {
    try_again(std::move(*arrival));
  } else {
    retries_.done(*arrival);
    give_up(std::move(*arrival), tuple_failed);
  }
  waker_.wake();
}

void BrokerSpout::retry(MessageId id) {
  auto arrival = take(id);
  if (!arrival) return;
  if (!traced_.empty()) end_trace(id, "");
  if (comes_again(*arrival)) {
    retries_.done(*arrival);
  } else {
    ++arrival->excused;
    try_again(std::move(*arrival));
  }
  waker_.wake();
}

void BrokerSpout::try_again(ChannelMessage arrival) {
  retried_->add();
  retries_.add(std::move(arrival), services_->clock->now());
}

/// Whether the log may get a line now. If not, the message is counted for the next line.
bool BrokerSpout::may_say(Complaints& complaints) const {
  const auto now = services_->clock->now();
  if (complaints.last && now - *complaints.last < quiet_time) {
    ++complaints.untold;
    return false;
  }
  complaints.last = now;
  return true;
}

/// Gives up a message that says an untrue sender. It has lines of its own in the log, so that a flood of such messages
/// does not hide what becomes of others.
void BrokerSpout::refuse(ChannelMessage arrival, const std::string& reason) {
  if (may_say(refused_)) {
    endpoints_logger.warn("a message of {} is not believed and {}: {}{}", arrival.reader->topic().name, fate(), reason,
                          others(refused_));
  }
  turn_away(std::move(arrival), reason);
}

void BrokerSpout::give_up(ChannelMessage arrival, const std::string& reason) {
  if (may_say(given_up_)) {
    endpoints_logger.warn("a message of driver {} is given up after {} {} and {}: {}{}",
                          arrival.delivery.message.driver_id, arrival.tries, arrival.tries == 1 ? "try" : "tries",
                          fate(), reason, others(given_up_));
  }
  turn_away(std::move(arrival), reason);
}

/// What becomes of messages that are given up, for the log.
std::string BrokerSpout::fate() const {
  return dead_letters_ ? "goes to " + endpoint_.reading.dead_letter : "is rejected";
}

/// The end of a line in the log, which counts the messages that got none.
std::string BrokerSpout::others(Complaints& complaints) {
  const auto untold = std::exchange(complaints.untold, 0);
  return untold == 0 ? "" : fmt::format("; {} more since the last such line", untold);
}

void BrokerSpout::turn_away(ChannelMessage arrival, const std::string& reason) {
  if (dead_letters_) {
    dead_letters_->send(std::move(arrival), reason);
    return;
  }
  rejected_->add();
  arrival.delivery.settle(brokers::Settlement::reject);
}

Values BrokerSpout::values_of(const ChannelMessage& arrival) const {
  const bool redelivered = arrival.delivery.redelivered || arrival.delivery.tries > 1 || arrival.tries > 0;
  return topology::values_of(arrival.delivery.message, endpoint_, payload_fields_, builder_.get(), redelivered);
}

MessageId BrokerSpout::keep(ChannelMessage arrival) {
  if (free_.empty()) {
    free_.push_back(static_cast<std::uint32_t>(slots_.size()));
    slots_.emplace_back();
  }
  const std::uint32_t place = free_.back();
  free_.pop_back();
  slots_[place].arrival = std::move(arrival);
  return (MessageId{++slots_[place].uses} << 32) | place;
}

std::optional<ChannelMessage> BrokerSpout::take(MessageId id) {
  const auto place = static_cast<std::uint32_t>(id);
  if (place >= slots_.size() || slots_[place].uses != id >> 32) return std::nullopt;
  auto arrival = std::exchange(slots_[place].arrival, std::nullopt);
  if (arrival) free_.push_back(place);
  return arrival;
}

}  // namespace iotcloud::topology
