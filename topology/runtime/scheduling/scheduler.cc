#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/slice_clock.h>
#include <iotcloud/topology/runtime/scheduling/timers.h>

namespace iotcloud::topology::internal {

namespace {
/// After this long a pool thread may give its run list to one that sleeps. Waking a thread costs the waking one a
/// system call, and the other one starts only some time later.
constexpr std::int64_t share_after_ns = 300'000;
/// A run list with more tasks than this is given away, too.
constexpr std::size_t many_tasks = 16;
/// After this long a pool thread puts its run list behind the tasks that wait for the pool.
constexpr std::int64_t turn_ns = 1'000'000;

}  // namespace

Scheduler::Scheduler(unsigned threads, std::chrono::microseconds caller_slice, std::chrono::microseconds long_slice,
                     MakeLane make_lane, Timers& timers)
    : threads_(threads),
      caller_slice_ns_(std::chrono::nanoseconds(caller_slice).count()),
      long_slice_ns_(std::chrono::nanoseconds(long_slice).count()),
      make_lane_(std::move(make_lane)),
      timers_(timers),
      spare_lane_(make_lane_(*this)) {
  for (unsigned i = 0; i < threads_; ++i) homes_.push_back(lanes_.emplace_back(make_lane_(*this)).get());
}

Scheduler::~Scheduler() {
  halt();
  join();
}

void Scheduler::start() {
  for (Lane* lane : homes_) pool_.emplace_back([this, lane] { pool_thread(*lane); });
}

void Scheduler::halt() {
  const config::MutexLock lock(mutex_);
  halted_.store(true);
  work_.notify_all();
}

void Scheduler::join() {
  for (std::jthread& thread : pool_) {
    if (thread.joinable()) thread.join();
  }
}

bool Scheduler::wait_halted(std::chrono::steady_clock::time_point deadline) {
  const config::MutexLock lock(mutex_);
  waited_for_.store(true);
  return changed_.wait_until(mutex_, deadline, [this]() IOTCLOUD_REQUIRES(mutex_) {
    for (const auto& lane : lanes_) {
      if (lane->running.load() != nullptr) return false;
    }
    return true;
  });
}

bool Scheduler::runs(const Runnable& task) const {
  const config::MutexLock lock(mutex_);
  for (const auto& lane : lanes_) {
    if (lane->running.load() == &task) return true;
  }
  return false;
}

// How a task becomes ready.

bool Scheduler::make_ready(Runnable& task) noexcept {
  // A read-modify-write even where the state does not change: the thread that changes the state next then also sees
  // what the caller wrote for the task before this call.
  State state = task.state_.load(std::memory_order_relaxed);
  while (true) {
    State next = state;
    if (state == State::idle) next = State::queued;
    if (state == State::running) next = State::notified;
    if (task.state_.compare_exchange_weak(state, next, std::memory_order_acq_rel, std::memory_order_relaxed)) {
      if (state != State::idle) return false;
      busy_.fetch_add(1);
      return true;
    }
  }
}

void Scheduler::now_idle() noexcept {
  if (busy_.fetch_sub(1) != 1 || !waited_for_.load()) return;
  const config::MutexLock lock(mutex_);
  changed_.notify_all();
}

bool Scheduler::runs_on_this_thread(Lane* lane) const {
  return lane != nullptr && &lane->scheduler() == this && lane->running.load(std::memory_order_relaxed) != nullptr;
}

void Scheduler::schedule(Runnable& task, bool much) noexcept {
  if (make_ready(task)) run_taken(task, false, much);
}

bool Scheduler::take(Runnable& task) noexcept {
  State idle = State::idle;
  if (!task.state_.compare_exchange_strong(idle, State::queued, std::memory_order_acq_rel)) return false;
  busy_.fetch_add(1);
  return true;
}

void Scheduler::run_taken(Runnable& task, bool next, bool much) noexcept {
  Lane* lane = Lane::of_this_thread();
  if (!runs_on_this_thread(lane)) {
    hand_over(task);
  } else if (much && send_home(*lane, task)) {
    return;
  } else if (next && lane->next == nullptr) {
    lane->next = &task;
  } else {
    lane->push(task);
  }
}

/// Gives a task to its home, if that is another lane, awake, and in no long slice.
bool Scheduler::send_home(const Lane& from, Runnable& task) noexcept {
  if (task.home_ == Runnable::anywhere || homes_.empty()) return false;
  Lane& home = *homes_[static_cast<std::size_t>(task.home_) % homes_.size()];
  if (&home == &from) return false;
  const std::int64_t began = home.slice_began_ns.load(std::memory_order_relaxed);
  if (began != 0 && from.now_ns - began > slice_limit_ns) return false;
  if (!home.push_if_awake(task, from.now_ns)) return false;
  timers_.watch();  // its slice may become long
  return true;
}

void Scheduler::run_now(Runnable& task) noexcept {
  Lane* mine = Lane::of_this_thread();
  if (halted_.load() || (mine != nullptr && &mine->scheduler() == this)) {
    schedule(task);  // this thread is in a task: it runs the new one after that
    return;
  }
  if (!make_ready(task)) return;
  Lane* lane = borrow_lane();
  run(*lane, threads_ > 0 ? Kind::caller : Kind::only, task);
  return_lane(lane);
}

void Scheduler::release(Runnable& task, bool ready) {
  const State was = task.state_.exchange(State::idle, std::memory_order_acq_rel);
  if (ready || was == State::notified) schedule(task);
}

void Scheduler::hand_over(Runnable& task) noexcept {
  ReadyList one;
  one.push(task);
  hand_over(one);
}

void Scheduler::hand_over(ReadyList& tasks) noexcept {
  if (tasks.empty()) return;
  const config::MutexLock lock(mutex_);
  for (std::size_t i = 0; i < tasks.size() && i < threads_; ++i) work_.notify_one();
  shared_.append(tasks);
  shared_count_.store(shared_.size(), std::memory_order_relaxed);
}

// Running.

void Scheduler::pool_thread(Lane& lane) {
  while (true) {
    Runnable* task = nullptr;
    {
      const config::MutexLock lock(mutex_);
      sleeping_.fetch_add(1, std::memory_order_relaxed);
      work_.wait(mutex_, [this]() IOTCLOUD_REQUIRES(mutex_) { return halted_.load() || !shared_.empty(); });
      sleeping_.fetch_sub(1, std::memory_order_relaxed);
      if (halted_.load()) return;
      task = shared_.pop();
      shared_count_.store(shared_.size(), std::memory_order_relaxed);
    }
    lane.wake();
    run(lane, Kind::pool, *task);
  }
}

void Scheduler::run_until_idle() {
  Lane* lane = borrow_lane();
  while (true) {
    Runnable* task = nullptr;
    {
      const config::MutexLock lock(mutex_);
      task = shared_.pop();
      shared_count_.store(shared_.size(), std::memory_order_relaxed);
    }
    if (task == nullptr) break;
    run(*lane, Kind::only, *task);
  }
  return_lane(lane);
}

Runnable* Scheduler::next_of(Lane& lane, Kind kind) noexcept {
  if (Runnable* next = std::exchange(lane.next, nullptr)) return next;
  return kind == Kind::pool ? lane.pop_or_sleep() : lane.pop();
}

void Scheduler::run(Lane& lane, Kind kind, Runnable& first) noexcept {
  const std::int64_t began = lane.now_ns = real_ns();
  for (Runnable* task = &first; task != nullptr; task = next_of(lane, kind)) {
    lane.slice_began_ns.store(lane.now_ns, std::memory_order_relaxed);
    lane.running.store(task);
    // read after `running` is set: either this thread sees halted_, or wait_halted() sees `running`
    if (halted_.load()) break;
    if (threads_ > 0 && lane.ready_count() > 0) timers_.watch();
    run_slice(lane, *task);
    if (lane.ready_count() > 0 && share(lane, kind, lane.now_ns - began)) break;
  }
  lane.slice_began_ns.store(0, std::memory_order_relaxed);
  lane.running.store(nullptr);
  if (halted_.load()) {
    const config::MutexLock lock(mutex_);
    changed_.notify_all();
  }
}

void Scheduler::run_slice(Lane& lane, Runnable& task) noexcept {
  bool counted = false;
  if (!task.executors_.enter(task, counted)) return;
  task.state_.exchange(State::running, std::memory_order_acq_rel);
  const bool more = task.slice(lane);
  if (counted) {
    if (Runnable* next = task.executors_.leave()) lane.push(*next);
  }
  if (more) {
    task.state_.exchange(State::queued, std::memory_order_acq_rel);
    lane.push(task);
    return;
  }
  State expected = State::running;
  if (task.state_.compare_exchange_strong(expected, State::idle, std::memory_order_acq_rel)) {
    now_idle();  // the task may run elsewhere now
  } else {
    task.state_.exchange(State::queued, std::memory_order_acq_rel);
    lane.push(task);
  }
}

/// Gives tasks of the lane's run list to the pool if that pays. \return true when the list is empty now and the thread
/// must stop working on it.
bool Scheduler::share(Lane& lane, Kind kind, std::int64_t busy_ns) noexcept {
  if (kind == Kind::only) return false;
  ReadyList tasks;
  if (kind == Kind::caller || (busy_ns >= turn_ns && shared_count_.load(std::memory_order_relaxed) > 0)) {
    if (kind == Kind::caller && busy_ns < caller_slice_ns_) return false;
    if (Runnable* next = std::exchange(lane.next, nullptr)) tasks.push(*next);
    lane.sleep(tasks);
    hand_over(tasks);
    return true;
  }
  const std::size_t ready = lane.ready_count() + (lane.next != nullptr ? 1 : 0);
  if (busy_ns < share_after_ns || ready < 2 || sleeping_.load(std::memory_order_relaxed) == 0) return false;
  const std::int64_t worth_moving_ns =
      lane.worth_moving_ns() + (lane.next != nullptr ? lane.next->worth_moving_ns() : 0);
  if (ready <= many_tasks && worth_moving_ns < worth_sharing_ns) return false;
  if (lane.next == nullptr) lane.next = lane.pop();
  lane.take_all(tasks);
  hand_over(tasks);
  return false;
}

bool Scheduler::offload_stuck_threads() {
  const std::int64_t now = real_ns();
  ReadyList freed;
  bool again = false;
  {
    const config::MutexLock lock(mutex_);
    for (const auto& lane : lanes_) {
      if (lane->ready_count() == 0) continue;
      const std::int64_t began = lane->slice_began_ns.load(std::memory_order_relaxed);
      if (began != 0 && now - began >= long_slice_ns_) {
        lane->take_all(freed);
      } else {
        again = true;
      }
    }
  }
  hand_over(freed);
  return again && !halted_.load();
}

void Scheduler::report_hanging(std::chrono::milliseconds limit) {
  const std::int64_t now = real_ns();
  std::vector<std::pair<Runnable*, std::int64_t>> hanging;  // task, start of its slice
  {
    const config::MutexLock lock(mutex_);
    for (const auto& lane : lanes_) {
      const std::int64_t began = lane->slice_began_ns.load(std::memory_order_relaxed);
      Runnable* task = lane->running.load();
      if (began == 0 || task == nullptr || now - began < std::chrono::nanoseconds(limit).count()) continue;
      if (lane->reported_hang_ns.exchange(began) != began) hanging.emplace_back(task, began);
    }
  }
  // hangs() is called without the lock, because it calls the user's on_error, which may call rebalance(), which takes
  // the lock. The pointers stay valid, because the tasks outlive the timers' thread, which runs this.
  for (const auto& [task, began] : hanging) task->hangs(now - began);
}

Scheduler::LongSlice Scheduler::longest_slice() const {
  const std::int64_t now = real_ns();
  LongSlice longest;
  const config::MutexLock lock(mutex_);
  for (const auto& lane : lanes_) {
    const std::int64_t began = lane->slice_began_ns.load(std::memory_order_relaxed);
    const Runnable* task = lane->running.load();
    if (began == 0 || task == nullptr || now - began <= longest.for_ns) continue;
    longest = {task, now - began};
  }
  return longest;
}

void Scheduler::set_limit(Executors& executors, int limit) {
  ReadyList freed = executors.set_limit(limit);
  hand_over(freed);
}

// Waiting, and lanes for callers.

bool Scheduler::wait_idle(std::chrono::steady_clock::time_point deadline, const std::function<bool()>& condition) {
  const config::MutexLock lock(mutex_);
  waited_for_.store(true);
  return changed_.wait_until(mutex_, deadline, [&]() IOTCLOUD_REQUIRES(mutex_) { return idle() && condition(); });
}

Lane* Scheduler::borrow_lane() {
  const config::MutexLock lock(mutex_);
  if (unused_.empty()) {
    lanes_.push_back(make_lane_(*this));
    return lanes_.back().get();
  }
  Lane* lane = unused_.back();
  unused_.pop_back();
  return lane;
}

void Scheduler::return_lane(Lane* lane) {
  const config::MutexLock lock(mutex_);
  unused_.push_back(lane);
}

}  // namespace iotcloud::topology::internal
