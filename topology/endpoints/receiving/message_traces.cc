#include <algorithm>
#include <stdexcept>

#include <fmt/format.h>

#include <iotcloud/topology/endpoints/receiving/message_traces.h>
#include <iotcloud/topology/topology_context.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology {

namespace {

std::int64_t nanoseconds_of(config::Clock::Instant time) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(time.time_since_epoch()).count();
}

}  // namespace

MessageTrace::MessageTrace(const brokers::Message& message, std::string driver, std::string topic,
                           std::int64_t now_ns) {
  const config::MutexLock lock(mutex_);
  way_.driver = std::move(driver);
  way_.gateway = message.gateway_id;
  way_.time_ms = message.time_ms;
  way_.topic = std::move(topic);
  way_.came_ns = now_ns;
}

void MessageTrace::emitted(const TopologyContext& /*task*/, const detail::TupleData& tuple, std::int64_t at_ns) noexcept
    try {
  const config::MutexLock lock(mutex_);
  if (emitted_.size() < 2 * MessageWay::most_steps) emitted_[&tuple] = at_ns;
} catch (const std::exception&) {
  // out of memory: the way has a gap
}

MessageWay::Step* MessageTrace::step_of(const TopologyContext& task, const detail::TupleData& tuple) {
  for (const Open& open : open_) {
    if (open.tuple == &tuple && open.task == task.task) return &way_.steps[open.place];
  }
  if (way_.steps.size() >= MessageWay::most_steps) return nullptr;
  open_.push_back({&tuple, task.task, way_.steps.size()});
  MessageWay::Step& step = way_.steps.emplace_back();
  step.component = task.component;
  step.task = task.task;
  step.from = tuple.stream->component;
  step.stream = tuple.stream->stream;
  if (const auto emitted = emitted_.find(&tuple); emitted != emitted_.end()) step.emitted_ns = emitted->second;
  return &step;
}

/// Another tuple may have the same address from now on.
void MessageTrace::close(const TopologyContext& task, const detail::TupleData& tuple) {
  std::erase_if(open_, [&](const Open& open) { return open.tuple == &tuple && open.task == task.task; });
}

void MessageTrace::executed(const TopologyContext& task, const detail::TupleData& tuple, std::int64_t begin_ns,
                            std::int64_t end_ns) noexcept try {
  const config::MutexLock lock(mutex_);
  MessageWay::Step* const step = step_of(task, tuple);
  if (step == nullptr) {
    ++way_.more_steps;
    return;
  }
  step->begin_ns = begin_ns;
  step->end_ns = end_ns;
  if (step->settled_ns != 0) close(task, tuple);
} catch (const std::exception&) {
  // out of memory: the way has a gap
}

void MessageTrace::settled(const TopologyContext& task, const detail::TupleData& tuple, std::int64_t at_ns,
                           bool acked) noexcept try {
  const config::MutexLock lock(mutex_);
  MessageWay::Step* const step = step_of(task, tuple);
  if (step == nullptr) return;
  if (step->settled_ns == 0) {
    step->settled_ns = at_ns;
    step->acked = acked;
  }
  if (step->end_ns != 0) close(task, tuple);  // otherwise executed() follows
} catch (const std::exception&) {
  // out of memory: the way has a gap
}

bool MessageTrace::take(const std::string& spout, std::int64_t now_ns, bool again) {
  const config::MutexLock lock(mutex_);
  if (way_.tries > 0 && !again) return false;
  way_.spout = spout;
  way_.taken_ns = now_ns;
  ++way_.tries;
  emitted_.clear();
  open_.clear();
  return true;
}

void MessageTrace::done(config::Clock::Instant now, const std::string& outcome) {
  const config::MutexLock lock(mutex_);
  way_.done_ns = nanoseconds_of(now);
  way_.outcome = outcome;
}

MessageWay MessageTrace::way() const {
  const config::MutexLock lock(mutex_);
  return way_;
}

bool MessageTrace::is_done() const {
  const config::MutexLock lock(mutex_);
  return way_.done_ns != 0;
}

void MessageTraces::came(const brokers::Message& message, const std::string& topic, const std::string& sender) {
  const std::string& driver = message.driver_id.empty() ? sender : message.driver_id;
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  expire(now);
  std::shared_ptr<MessageTrace> trace;
  for (auto& [id, open] : open_) {
    if (open.question.driver != driver) continue;
    const std::int64_t slot = message.time_ms / open.question.every_ms;
    const auto before = open.slots.find(topic);
    if (before == open.slots.end() ? open.slots.size() >= most_topics : before->second == slot) continue;
    open.slots[topic] = slot;
    if (!trace) {
      const Key key{topic, driver, message.time_ms};
      auto followed = followed_.find(key);
      if (followed == followed_.end()) {
        if (followed_.size() >= most_followed) {
          ++open.missed;
          continue;
        }
        followed =
            followed_
                .emplace(key, Kept{std::make_shared<MessageTrace>(message, driver, topic, nanoseconds_of(now)), now})
                .first;
      }
      trace = followed->second.trace;
    }
    open.kept.push_back({trace, now});
    if (open.kept.size() <= most_kept) continue;
    open.kept.pop_front();
    ++open.missed;
  }
}

std::shared_ptr<MessageTrace> MessageTraces::take(const brokers::Message& message, const std::string& topic,
                                                  const std::string& spout, bool again) {
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  const auto found = followed_.find({topic, message.driver_id, message.time_ms});
  if (found == followed_.end() || !found->second.trace->take(spout, nanoseconds_of(now), again)) return nullptr;
  return found->second.trace;
}

MessageTraces::Answer MessageTraces::poll(const Question& question) {
  if (question.id.empty()) throw std::invalid_argument("a question has an id");
  if (question.driver.empty())
    throw std::invalid_argument("name the driver instance whose messages are to be followed");
  if (question.every_ms < 1) throw std::invalid_argument("every_ms is 1 or more");
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  expire(now);
  if (!open_.contains(question.id) && open_.size() >= most_questions)
    throw std::invalid_argument(fmt::format("{} questions are open, which is the limit", open_.size()));
  Open& open = open_[question.id];
  if (open.question.driver != question.driver || open.question.every_ms != question.every_ms)
    open = {question, now, {}, {}, 0};
  open.asked = now;
  show();
  Answer answer;
  answer.missed = std::exchange(open.missed, 0);
  std::erase_if(open.kept, [&](const Kept& kept) {
    if (!kept.trace->is_done() && now - kept.since < longest_way) return false;
    answer.ways.push_back(kept.trace->way());
    return true;
  });
  return answer;
}

void MessageTraces::end(const std::string& id) {
  const config::MutexLock lock(mutex_);
  open_.erase(id);
  show();
}

void MessageTraces::expire(config::Clock::Instant now) {
  std::erase_if(open_, [&](const auto& entry) { return now - entry.second.asked >= patience; });
  // A message that is tried again is followed further, as long as somebody asks.
  std::erase_if(followed_, [&](const auto& entry) {
    return entry.second.trace->is_done() || now - entry.second.since >= 4 * longest_way;
  });
  show();
}

void MessageTraces::show() {
  const bool any = !open_.empty();
  if (!any) followed_.clear();
  if (any_.exchange(any) != any && on_change_) on_change_(any);
}

}  // namespace iotcloud::topology
