#include <algorithm>
#include <iterator>
#include <map>
#include <optional>

#include <iotcloud/gateway/host/logger.h>
#include <iotcloud/gateway/host/shared_channels.h>

namespace iotcloud::gateway {

namespace {

constexpr std::chrono::seconds quiet_time{10};         ///< time between two lines in the log about dropped messages
constexpr std::chrono::milliseconds look_period{100};  ///< between two looks at messages that wait
/// The most looks between two times that a message is passed whose instance is about to be open.
constexpr std::uint64_t longest_pause = 20;
constexpr std::size_t most_absent = 10'000;  ///< ids of instances that did not come, for each topic
/// The most bytes (size_of()) that are passed and not answered; a larger message is passed alone.
constexpr std::size_t most_passed = std::size_t{128} << 10;
constexpr std::size_t largest_passed = std::size_t{4} << 20;  ///< a larger message is not passed

}  // namespace

/// What the hubs of a host share.
struct SharedChannels::Common {
  Common(Passing to_others, const config::Clock& of) : passing(std::move(to_others)), clock(of) {}

  bool expects(const discovery::InstanceId& instance) const {
    const config::MutexLock lock(mutex);
    const auto found = expected.find(instance);
    if (found == expected.end()) return false;
    return !found->second || clock.now() - *found->second < longest_wait;
  }
  std::int64_t new_number() {
    const config::MutexLock lock(mutex);
    return ++last_number;
  }

  const Passing passing;
  const config::Clock& clock;
  mutable config::Mutex mutex;
  /// The instances that the host was told to create, and when they failed since.
  std::map<discovery::InstanceId, std::optional<config::Clock::Instant>> expected IOTCLOUD_GUARDED_BY(mutex);
  std::int64_t last_number IOTCLOUD_GUARDED_BY(mutex) = 0;  ///< of the messages that were passed
};

/// Answers for the messages that other hosts have passed: settling such a delivery is the answer.
class SharedChannels::Answerer final : public brokers::Settler {
 public:
  Answerer(std::shared_ptr<const Common> common, discovery::InstanceId instance)
      : common_(std::move(common)), instance_(std::move(instance)) {}
  void settle(std::uint64_t number, brokers::Settlement settlement) noexcept override try {
    PassAnswer answer = PassAnswer::handled;
    if (settlement == brokers::Settlement::reject) answer = PassAnswer::failed;
    if (settlement == brokers::Settlement::retry) {
      answer = common_->expects(instance_) ? PassAnswer::comes : PassAnswer::nowhere;
    }
    common_->passing.answer(static_cast<std::int64_t>(number), answer);
  } catch (const std::exception& e) {
    host_logger.error("a message that another host has passed is not answered: {}", e.what());
  }

 private:
  const std::shared_ptr<const Common> common_;
  const discovery::InstanceId instance_;
};

/// One topic: its subscription, the instances that are open, and the messages for those that are not.
struct SharedChannels::Hub : std::enable_shared_from_this<Hub> {
  using Instant = config::Clock::Instant;
  using Waiting = ChannelQueue::Waiting;
  /// What the host has been told of a line's instance since a message of the line was last handled.
  enum class Told {
    nothing,
    nowhere,       ///< the gateway says that no host runs it
    comes,         ///< the gateway says that it is about to be open
    gateway_away,  ///< nobody could be asked
    too_large,     ///< no frame to the gateway takes the first message
  };
  /// The messages of one instance, in the order in which they came.
  struct Line {
    std::deque<Waiting> messages;
    std::int64_t asked = 0;  ///< the first message was passed under this number, and not answered; 0: it was not passed
    Instant progress{};      ///< when an instance, here or on another host, last had one of them in hand
    Told told = Told::nothing;
    bool moving = false;          ///< hand_over() hands the messages to the instance
    std::uint64_t pause = 0;      ///< looks that the next message passed waits if its instance is not open then
    std::uint64_t next_look = 0;  ///< the first message is not passed before this look
  };
  /// Why a message is dropped: the label `reason` of its counter.
  enum class Reason {
    deadline,      ///< the channel's has passed
    no_instance,   ///< no host of the gateway runs its instance
    too_large,     ///< no host that it may be handed to runs its instance, and it is too large to be passed to another
    not_started,   ///< its instance was about to be open all the time
    gateway_away,  ///< there was no gateway that could pass it
    not_asked,     ///< its turn to be passed did not come, because other messages were under way
  };
  struct Drop {
    Waiting waiting;
    Reason reason;
  };
  using Late = std::deque<Drop>;

  Hub(const SharedChannels& owner, const PlannedChannel& channel, std::shared_ptr<brokers::Broker> of)
      : loop(owner.loop_),
        clock(owner.clock_),
        common(owner.common_),
        topic(channel.topic.name),
        deadline(channel.spec.deadline),
        metrics(owner.metrics_),
        labels({{"driver", channel.record.driver}, {"channel", channel.spec.name}}),
        broker(std::move(of)) {}

  void dispatch(brokers::Delivery delivery);
  void take(PassedMessage passed);
  void hand_over(const discovery::InstanceId& instance);
  void take_back(const discovery::InstanceId& instance, std::deque<Waiting> unhandled) IOTCLOUD_REQUIRES(mutex);
  void insert(Line& line, Waiting waiting) IOTCLOUD_REQUIRES(mutex);
  bool passable(const Line& line) const IOTCLOUD_REQUIRES(mutex);
  void pass_on();
  bool answered(std::int64_t number, PassAnswer answer);
  bool came_back(std::int64_t number, Told told, std::optional<brokers::Settlement> settlement);
  void nobody_answers();
  void look_soon() IOTCLOUD_REQUIRES(mutex);
  void look();
  std::optional<Reason> judge(const discovery::InstanceId& instance, const Line& line) const IOTCLOUD_REQUIRES(mutex);
  static const char* name_of(Reason reason);
  void drop_late_ones();
  Late late_ones() IOTCLOUD_REQUIRES(mutex);

  const std::shared_ptr<EventLoop> loop;
  const config::Clock& clock;
  const std::shared_ptr<Common> common;
  const std::string topic;
  const std::chrono::milliseconds deadline;  ///< the channel's; 0: none
  config::Metrics& metrics;
  const config::Labels labels;  ///< of the counters of dropped messages, which have their reason, too
  const std::shared_ptr<brokers::Broker> broker;

  config::Mutex mutex;
  std::map<discovery::InstanceId, std::shared_ptr<ChannelQueue>, std::less<>> members IOTCLOUD_GUARDED_BY(mutex);
  /// The messages for instances that are not open here, and for those that are being handed their messages.
  std::map<discovery::InstanceId, Line, std::less<>> lines IOTCLOUD_GUARDED_BY(mutex);
  /// Instances that did not come in time, and since when: messages that come later do not wait.
  std::map<discovery::InstanceId, Instant, std::less<>> absent IOTCLOUD_GUARDED_BY(mutex);
  std::uint64_t last_place IOTCLOUD_GUARDED_BY(mutex) = 0;       ///< of the messages that came
  discovery::InstanceId last_passed IOTCLOUD_GUARDED_BY(mutex);  ///< the instance whose turn was last
  std::uint64_t looks IOTCLOUD_GUARDED_BY(mutex) = 0;            ///< of the timer
  std::size_t passed_bytes IOTCLOUD_GUARDED_BY(mutex) = 0;       ///< of the messages that were passed and not answered
  bool looking_soon IOTCLOUD_GUARDED_BY(mutex) = false;
  std::size_t untold IOTCLOUD_GUARDED_BY(mutex) = 0;  ///< messages dropped since the last line in the log
  std::optional<Instant> last_told IOTCLOUD_GUARDED_BY(mutex);
  /// Last, so that it is destroyed first: its handler uses the other members, and what they hold goes back to the
  /// broker after it.
  std::unique_ptr<brokers::Subscription> subscription;
};

const char* SharedChannels::Hub::name_of(Reason reason) {
  switch (reason) {
    case Reason::deadline:
      return "deadline";
    case Reason::too_large:
      return "too_large";
    case Reason::not_started:
      return "not_started";
    case Reason::gateway_away:
      return "gateway_away";
    case Reason::not_asked:
      return "not_asked";
    case Reason::no_instance:
      break;
  }
  return "no_instance";
}

/// Hands a message to its instance, or lets it wait behind others of that instance. Runs on the broker's thread, one
/// message at a time.
void SharedChannels::Hub::dispatch(brokers::Delivery delivery) {
  const discovery::InstanceId instance(delivery.message.driver_id);
  Waiting waiting{std::move(delivery), clock.now()};
  std::shared_ptr<ChannelQueue> queue;
  bool fresh = false;
  {
    const config::MutexLock lock(mutex);
    waiting.place = ++last_place;
    const auto member = members.find(instance);
    fresh = !lines.contains(instance);
    if (fresh && member != members.end()) {
      queue = member->second;
    } else {
      insert(lines[instance], std::move(waiting));
    }
  }
  if (!queue) {
    if (fresh) look();
    return;
  }
  auto closed = queue->push(std::move(waiting));
  if (!closed) return;
  {
    const config::MutexLock lock(mutex);
    insert(lines[instance], std::move(*closed));
  }
  hand_over(instance);  // to the instance that was opened anew and may have joined by now
}

void SharedChannels::Hub::take(PassedMessage passed) {
  const discovery::InstanceId instance(passed.message.driver_id);
  // Destroyed unless it is queued, which answers that its instance is not open here.
  brokers::Delivery delivery(std::move(passed.message), false, std::make_shared<Answerer>(common, instance),
                             static_cast<std::uint64_t>(passed.number));
  std::shared_ptr<ChannelQueue> queue;
  {
    const config::MutexLock lock(mutex);
    const auto member = members.find(instance);
    // Messages of an earlier time, when this host read the topic, come first.
    if (member != members.end() && !lines.contains(instance)) queue = member->second;
  }
  if (queue) queue->push({std::move(delivery), clock.now(), 0, true});
}

/// Puts a message into its place in the line.
void SharedChannels::Hub::insert(Line& line, Waiting waiting) {
  auto& messages = line.messages;
  const auto behind = std::upper_bound(messages.begin(), messages.end(), waiting.place,
                                       [](std::uint64_t place, const Waiting& other) { return place < other.place; });
  messages.insert(behind, std::move(waiting));
  look_soon();
}

/// Gives an instance that is open now the messages that waited for it, in order and before new ones.
void SharedChannels::Hub::hand_over(const discovery::InstanceId& instance) {
  config::UniqueLock lock(mutex);
  auto line = lines.find(instance);
  if (line == lines.end() || line->second.moving || line->second.asked != 0) return;
  line->second.moving = true;
  std::shared_ptr<ChannelQueue> closed;
  while (true) {
    line = lines.find(instance);
    const auto member = members.find(instance);
    auto& messages = line->second.messages;
    if (messages.empty()) {
      lines.erase(line);
      return;
    }
    if (member == members.end() || member->second == closed) {
      line->second.moving = false;
      return;
    }
    Waiting next = std::move(messages.front());
    messages.pop_front();
    const auto queue = member->second;
    lock.unlock();
    auto returned = queue->push(std::move(next));
    lock.lock();
    if (!returned) continue;
    insert(lines[instance], std::move(*returned));
    closed = queue;
  }
}

/// The messages that an instance leaves unhandled wait for its return, before those that came after them.
void SharedChannels::Hub::take_back(const discovery::InstanceId& instance, std::deque<Waiting> unhandled) {
  if (unhandled.empty()) return;
  auto& line = lines[instance];
  for (auto& waiting : unhandled) insert(line, std::move(waiting));
  line.progress = clock.now();
}

/// Whether the gateway's other hosts may get the line's first message.
bool SharedChannels::Hub::passable(const Line& line) const {
  return common->passing.pass && size_of(line.messages.front().delivery.message) <= largest_passed;
}

/// Passes the first messages of the lines to the gateway's other hosts, in turn.
void SharedChannels::Hub::pass_on() {
  if (!common->passing.pass) return;
  std::vector<PassedMessage> passed;
  {
    const config::MutexLock lock(mutex);
    auto place = lines.upper_bound(last_passed);
    for (std::size_t left = lines.size(); left > 0; --left, ++place) {
      if (place == lines.end()) place = lines.begin();
      auto& [instance, line] = *place;
      if (instance.empty() || line.asked != 0 || line.moving || line.messages.empty() || line.next_look > looks ||
          members.contains(instance) || !passable(line)) {
        continue;
      }
      const auto& message = line.messages.front().delivery.message;
      const std::size_t size = size_of(message);
      if (passed_bytes > 0 && passed_bytes + size > most_passed) break;  // it is the next one
      passed_bytes += size;
      line.asked = common->new_number();
      last_passed = instance;
      passed.push_back({line.asked, topic, message});
    }
  }
  for (const auto& one : passed) {
    const auto problem = common->passing.pass(one);
    if (problem == NotPassed::gateway_away) came_back(one.number, Told::gateway_away, std::nullopt);
    if (problem == NotPassed::too_large) came_back(one.number, Told::too_large, std::nullopt);
  }
}

/// \return whether the message was passed by this hub
bool SharedChannels::Hub::answered(std::int64_t number, PassAnswer answer) {
  switch (answer) {
    case PassAnswer::handled:
      return came_back(number, Told::nothing, brokers::Settlement::accept);
    case PassAnswer::failed:
      return came_back(number, Told::nothing, brokers::Settlement::reject);
    case PassAnswer::comes:
      return came_back(number, Told::comes, std::nullopt);
    case PassAnswer::nowhere:
      break;
  }
  return came_back(number, Told::nowhere, std::nullopt);
}

/// A message is not on its way any more. \param settlement null: no driver has seen it. It is judged now: at the next
/// look it will be on its way again. \return whether this hub passed it
bool SharedChannels::Hub::came_back(std::int64_t number, Told told, std::optional<brokers::Settlement> settlement) {
  std::optional<brokers::Delivery> done;
  discovery::InstanceId instance;
  bool open_here = false;
  {
    const config::MutexLock lock(mutex);
    const auto found =
        std::find_if(lines.begin(), lines.end(), [&](const auto& entry) { return entry.second.asked == number; });
    if (found == lines.end()) return false;
    instance = found->first;
    Line& line = found->second;
    line.asked = 0;
    passed_bytes -= size_of(line.messages.front().delivery.message);
    line.told = told;
    const bool comes = told == Told::comes || told == Told::gateway_away;
    line.pause = comes ? std::clamp<std::uint64_t>(2 * line.pause, 1, longest_pause) : 0;
    line.next_look = looks + line.pause;
    if (settlement) {
      done = std::move(line.messages.front().delivery);
      line.messages.pop_front();
      line.progress = clock.now();
      absent.erase(instance);
    }
    open_here = members.contains(instance);
    if (line.messages.empty()) lines.erase(found);
  }
  if (done) {
    done->settle(*settlement);
    pass_on();
  } else {
    drop_late_ones();
  }
  if (open_here) hand_over(instance);
  return true;
}

void SharedChannels::Hub::nobody_answers() {
  std::vector<discovery::InstanceId> open_here;
  {
    const config::MutexLock lock(mutex);
    passed_bytes = 0;
    for (auto& [instance, line] : lines) {
      line.pause = line.next_look = 0;
      if (std::exchange(line.asked, 0) != 0 && members.contains(instance)) open_here.push_back(instance);
    }
  }
  for (const auto& instance : open_here) hand_over(instance);
}

void SharedChannels::Hub::look_soon() {
  if (std::exchange(looking_soon, true)) return;
  loop->start_timer(look_period, std::chrono::microseconds{0}, [weak = weak_from_this()] {
    const auto self = weak.lock();
    if (!self) return;
    {
      const config::MutexLock lock(self->mutex);
      self->looking_soon = false;
      ++self->looks;
      if (!self->lines.empty()) self->look_soon();
    }
    self->look();
  });
}

/// Passes on the messages that wait, and drops those that have waited too long.
void SharedChannels::Hub::look() {
  pass_on();
  drop_late_ones();
}

/// \return why the line's first message is dropped now; null: it waits
std::optional<SharedChannels::Hub::Reason> SharedChannels::Hub::judge(const discovery::InstanceId& instance,
                                                                      const Line& line) const {
  if (instance.empty()) return Reason::no_instance;
  const auto now = clock.now();
  const auto since = line.messages.front().since;
  if (deadline.count() > 0 && now - since >= deadline) return Reason::deadline;
  const auto waited = now - std::max(since, line.progress);
  const auto after_longest_wait = [&](Reason reason) {
    return waited >= longest_wait ? std::optional(reason) : std::nullopt;
  };
  if (line.told == Told::comes || common->expects(instance)) return after_longest_wait(Reason::not_started);
  if (line.told == Told::gateway_away) return after_longest_wait(Reason::gateway_away);
  if (line.told == Told::nothing && passable(line)) return after_longest_wait(Reason::not_asked);
  const auto gone = absent.find(instance);
  const bool came_later = gone != absent.end() && since >= gone->second;
  if (waited < grace && !came_later) return std::nullopt;
  const bool asked = !common->passing.pass || line.told == Told::nowhere;
  return asked ? Reason::no_instance : Reason::too_large;
}

SharedChannels::Hub::Late SharedChannels::Hub::late_ones() {
  Late late;
  for (auto place = lines.begin(); place != lines.end();) {
    auto& [instance, line] = *place;
    auto& messages = line.messages;
    // An open instance is being handed its messages. One that was passed may be in a driver's hand.
    if (line.moving || line.asked != 0 || messages.empty() || members.contains(instance)) {
      ++place;
      continue;
    }
    for (auto reason = judge(instance, line); reason; reason = judge(instance, line)) {
      late.push_back({std::move(messages.front()), *reason});
      messages.pop_front();
      if (line.told == Told::too_large) line.told = Told::nothing;  // the next message may fit
      const bool is_absent = reason == Reason::no_instance || reason == Reason::too_large;
      if (is_absent && !instance.empty() && !absent.contains(instance)) {
        if (absent.size() >= most_absent) absent.erase(absent.begin());
        absent.emplace(instance, clock.now());
      }
      if (messages.empty()) break;
    }
    place = messages.empty() ? lines.erase(place) : std::next(place);
  }
  return late;
}

void SharedChannels::Hub::drop_late_ones() {
  Late late;
  {
    const config::MutexLock lock(mutex);
    late = late_ones();
  }
  if (late.empty()) return;
  for (auto& [waiting, reason] : late) {
    auto with_reason = labels;
    with_reason["reason"] = name_of(reason);
    metrics.counter("iotcloud_driver_lost_total", lost_help, with_reason).add();
    waiting.delivery.settle(brokers::Settlement::accept);
  }
  std::size_t dropped = 0;
  {
    const config::MutexLock lock(mutex);
    untold += late.size();
    const auto now = clock.now();
    if (last_told && now - *last_told < quiet_time) return;
    last_told = now;
    dropped = std::exchange(untold, 0);
  }
  host_logger.warn("{}: {} message(s) dropped that no driver instance here got; the last for \"{}\" ({})", topic,
                   dropped, late.back().waiting.delivery.message.driver_id, name_of(late.back().reason));
}

SharedChannels::SharedChannels(std::shared_ptr<EventLoop> loop, const config::Clock& clock, config::Metrics& metrics,
                               Passing passing)
    : loop_(std::move(loop)),
      clock_(clock),
      metrics_(metrics),
      common_(std::make_shared<Common>(std::move(passing), clock)) {}

SharedChannels::~SharedChannels() = default;

void SharedChannels::expect(const discovery::InstanceId& instance) {
  {
    const config::MutexLock lock(common_->mutex);
    common_->expected[instance] = std::nullopt;
  }
  for (const auto& hub : hubs()) {
    const config::MutexLock lock(hub->mutex);
    hub->absent.erase(instance);
  }
}

void SharedChannels::failed(const discovery::InstanceId& instance) {
  const config::MutexLock lock(common_->mutex);
  const auto found = common_->expected.find(instance);
  if (found != common_->expected.end()) found->second = clock_.now();
}

void SharedChannels::expect_no_more(const discovery::InstanceId& instance) {
  const config::MutexLock lock(common_->mutex);
  common_->expected.erase(instance);
}

std::vector<std::shared_ptr<SharedChannels::Hub>> SharedChannels::hubs() const {
  std::vector<std::shared_ptr<Hub>> all;
  const config::MutexLock lock(mutex_);
  for (const auto& [key, hub] : hubs_) all.push_back(hub);
  return all;
}

void SharedChannels::join(const PlannedChannel& channel, const std::shared_ptr<brokers::Broker>& broker,
                          const discovery::InstanceId& instance, std::shared_ptr<ChannelQueue> queue) {
  std::shared_ptr<Hub> joined;
  {
    const config::MutexLock lock(mutex_);
    auto& hub = hubs_[key_of(channel)];
    const bool first = !hub;
    if (first) hub = std::make_shared<Hub>(*this, channel, broker);
    joined = hub;
    {
      const config::MutexLock members_lock(hub->mutex);
      hub->members[instance] = std::move(queue);
    }
    if (first) {
      // No keep_last on the shared subscription: messages of one instance would supersede another's. Each ChannelQueue
      // applies keep_last to its own messages.
      brokers::SubscriptionOptions options;
      options.priority = channel.spec.priority;
      options.original_queue = channel.original_queue;
      hub->subscription = broker->subscribe(channel.topic, options,
                                            [hub = hub.get()](brokers::Delivery d) { hub->dispatch(std::move(d)); });
    }
  }
  joined->hand_over(instance);
}

void SharedChannels::leave(const PlannedChannel& channel, const discovery::InstanceId& instance,
                           std::deque<ChannelQueue::Waiting> unhandled) {
  // destroyed after the lock is released, because the end of its subscription waits for the handler
  std::shared_ptr<Hub> last;
  const config::MutexLock lock(mutex_);
  const auto found = hubs_.find(key_of(channel));
  if (found == hubs_.end()) return;
  const auto hub = found->second;
  const config::MutexLock members_lock(hub->mutex);
  hub->members.erase(instance);
  hub->take_back(instance, std::move(unhandled));
  if (!hub->members.empty()) return;
  last = std::move(found->second);
  hubs_.erase(found);
}

void SharedChannels::take(PassedMessage passed) {
  for (const auto& hub : hubs()) {
    if (hub->topic != passed.topic) continue;
    hub->take(std::move(passed));
    return;
  }
  const discovery::InstanceId instance(passed.message.driver_id);
  Answerer(common_, instance).settle(static_cast<std::uint64_t>(passed.number), brokers::Settlement::retry);
}

void SharedChannels::answered(std::int64_t number, PassAnswer answer) {
  for (const auto& hub : hubs()) {
    if (hub->answered(number, answer)) return;
  }
}

void SharedChannels::nobody_answers() {
  for (const auto& hub : hubs()) hub->nobody_answers();
}

}  // namespace iotcloud::gateway
