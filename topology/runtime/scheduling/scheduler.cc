#include <random>

#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/slice_clock.h>
#include <iotcloud/topology/runtime/scheduling/timers.h>

namespace iotcloud::topology::internal {

namespace {
/// A pool thread shares its run list with one that sleeps after so long: waking costs some 5 us here and 50 us there.
constexpr std::int64_t share_after_ns = 300'000;
/// Work that is worth another thread. Quick calls on few tuples are not: what crosses from one core's cache to
/// another's costs more than they do (a word count on two cores got slower by a fifth).
constexpr std::int64_t worth_sharing_ns = 50'000;
constexpr std::size_t many_tasks = 16;
/// A pool thread lets the tasks that all threads share have a turn after so long.
constexpr std::int64_t turn_ns = 1'000'000;

using State = Task::State;
}  // namespace

Scheduler::Scheduler(unsigned threads, std::chrono::microseconds caller_slice, std::chrono::microseconds long_slice,
                     std::size_t tasks, Timers& timers)
    : threads_(threads),
      caller_slice_ns_(std::chrono::nanoseconds(caller_slice).count()),
      long_slice_ns_(std::chrono::nanoseconds(long_slice).count()),
      tasks_(tasks),
      timers_(timers),
      spare_lane_(new_lane()) {}

Scheduler::~Scheduler() {
  halt();
  join();
}

std::unique_ptr<Lane> Scheduler::new_lane() {
  std::random_device device;
  return std::make_unique<Lane>(*this, tasks_, (std::uint64_t{device()} << 32) | device());
}

void Scheduler::start() {
  for (unsigned i = 0; i < threads_; ++i) {
    lanes_.push_back(new_lane());
    pool_.emplace_back([this, lane = lanes_.back().get()] { pool_thread(*lane); });
  }
}

void Scheduler::halt() {
  const std::lock_guard lock(mutex_);
  halted_.store(true);
  work_.notify_all();
}

void Scheduler::join() {
  for (std::jthread& thread : pool_) {
    if (thread.joinable()) thread.join();
  }
}

bool Scheduler::wait_halted(std::chrono::steady_clock::time_point deadline) {
  std::unique_lock lock(mutex_);
  waited_for_.store(true);
  return changed_.wait_until(lock, deadline, [this] {
    for (const auto& lane : lanes_) {
      if (lane->running.load() != nullptr) return false;
    }
    return true;
  });
}

bool Scheduler::runs(const Task& task) const {
  const std::lock_guard lock(mutex_);
  for (const auto& lane : lanes_) {
    if (lane->running.load() == &task) return true;
  }
  return false;
}

// Readiness.

bool Scheduler::make_ready(Task& task) noexcept {
  // Always a read-modify-write, also where nothing changes: so the news that was put before is seen by whoever takes
  // the state after us.
  State state = task.state.load(std::memory_order_relaxed);
  while (true) {
    State next = state;
    if (state == State::idle) next = State::queued;
    if (state == State::running) next = State::notified;
    if (task.state.compare_exchange_weak(state, next, std::memory_order_acq_rel, std::memory_order_relaxed)) {
      if (state != State::idle) return false;
      busy_.fetch_add(1);
      return true;
    }
  }
}

void Scheduler::now_idle() noexcept {
  if (busy_.fetch_sub(1) != 1 || !waited_for_.load()) return;
  const std::lock_guard lock(mutex_);
  changed_.notify_all();
}

void Scheduler::schedule(Task& task) noexcept {
  if (!make_ready(task)) return;
  Lane* lane = Lane::of_this_thread();
  if (lane != nullptr && &lane->scheduler() == this && lane->running.load(std::memory_order_relaxed) != nullptr) {
    lane->push(task);
  } else {
    hand_over(task);
  }
}

void Scheduler::run_now(Task& task) noexcept {
  Lane* mine = Lane::of_this_thread();
  if (halted_.load() || (mine != nullptr && &mine->scheduler() == this)) {
    schedule(task);  // inside a task already: it runs on this thread as well, after that
    return;
  }
  if (!make_ready(task)) return;
  Lane* lane = borrow_lane();
  lane->push(task);
  run(*lane, threads_ > 0 ? Kind::caller : Kind::only);
  return_lane(lane);
}

void Scheduler::release(Task& task, bool ready) {
  const State was = task.state.exchange(State::idle, std::memory_order_acq_rel);
  if (ready || was == State::notified) schedule(task);
}

void Scheduler::hand_over(Task& task) noexcept {
  ReadyList one;
  one.push(task);
  hand_over(one);
}

void Scheduler::hand_over(ReadyList& tasks) noexcept {
  if (tasks.empty()) return;
  const std::lock_guard lock(mutex_);
  for (std::size_t i = 0; i < tasks.size() && i < threads_; ++i) work_.notify_one();
  shared_.append(tasks);
  shared_count_.store(shared_.size(), std::memory_order_relaxed);
}

// Running.

void Scheduler::pool_thread(Lane& lane) {
  while (true) {
    Task* task = nullptr;
    {
      std::unique_lock lock(mutex_);
      sleeping_.fetch_add(1, std::memory_order_relaxed);
      work_.wait(lock, [this] { return halted_.load() || !shared_.empty(); });
      sleeping_.fetch_sub(1, std::memory_order_relaxed);
      if (halted_.load()) return;
      task = shared_.pop();
      shared_count_.store(shared_.size(), std::memory_order_relaxed);
    }
    lane.push(*task);
    run(lane, Kind::pool);
  }
}

void Scheduler::run_until_idle() {
  Lane* lane = borrow_lane();
  while (true) {
    Task* task = nullptr;
    {
      const std::lock_guard lock(mutex_);
      task = shared_.pop();
      shared_count_.store(shared_.size(), std::memory_order_relaxed);
    }
    if (task == nullptr) break;
    lane->push(*task);
    run(*lane, Kind::only);
  }
  return_lane(lane);
}

void Scheduler::run(Lane& lane, Kind kind) noexcept {
  const std::int64_t began = lane.now_ns = real_ns();
  lane.slice_began_ns.store(began, std::memory_order_relaxed);
  while (Task* task = lane.pop()) {
    lane.running.store(task);
    if (halted_.load()) break;  // after `running`: either we see it, or who waits sees us
    if (threads_ > 0 && lane.has_ready()) timers_.watch();
    run_slice(lane, *task);
    if (!lane.has_ready()) continue;
    lane.slice_began_ns.store(lane.now_ns, std::memory_order_relaxed);
    if (share(lane, kind, lane.now_ns - began)) break;
  }
  lane.slice_began_ns.store(0, std::memory_order_relaxed);
  lane.running.store(nullptr);
  if (halted_.load()) {
    const std::lock_guard lock(mutex_);
    changed_.notify_all();
  }
}

void Scheduler::run_slice(Lane& lane, Task& task) noexcept {
  bool counted = false;
  if (!task.executors->enter(task, counted)) return;
  task.state.exchange(State::running, std::memory_order_acq_rel);
  const bool more = task.slice(lane);
  if (counted) {
    if (Task* next = task.executors->leave()) lane.push(*next);
  }
  if (more) {
    task.state.exchange(State::queued, std::memory_order_acq_rel);
    lane.push(task);
    return;
  }
  State expected = State::running;
  if (task.state.compare_exchange_strong(expected, State::idle, std::memory_order_acq_rel)) {
    now_idle();  // the task may run elsewhere now
  } else {
    task.state.exchange(State::queued, std::memory_order_acq_rel);
    lane.push(task);
  }
}

/// \return true when this thread has given everything away and stops.
bool Scheduler::share(Lane& lane, Kind kind, std::int64_t busy_ns) noexcept {
  if (kind == Kind::only) return false;
  ReadyList tasks;
  if (kind == Kind::caller || (busy_ns >= turn_ns && shared_count_.load(std::memory_order_relaxed) > 0)) {
    if (kind == Kind::caller && busy_ns < caller_slice_ns_) return false;
    lane.take_all(tasks);
    hand_over(tasks);
    return true;
  }
  if (busy_ns < share_after_ns || lane.ready_count() < 2 || sleeping_.load(std::memory_order_relaxed) == 0) {
    return false;
  }
  const bool worth_it = lane.ready_count() > many_tasks || lane.waiting_ns() >= worth_sharing_ns;
  if (!worth_it) return false;
  lane.take_all(tasks);
  if (Task* mine = tasks.pop()) lane.push(*mine);
  hand_over(tasks);
  return false;
}

bool Scheduler::look() {
  const std::int64_t now = real_ns();
  ReadyList freed;
  bool again = false;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& lane : lanes_) {
      if (!lane->has_ready()) continue;
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
  const std::lock_guard lock(mutex_);  // lanes stay; a task lives as long as its scheduler
  for (const auto& lane : lanes_) {
    const std::int64_t began = lane->slice_began_ns.load(std::memory_order_relaxed);
    Task* task = lane->running.load();
    if (began == 0 || task == nullptr || now - began < std::chrono::nanoseconds(limit).count()) continue;
    if (lane->reported_hang_ns.exchange(began) == began) continue;
    task->report_error("does not return from user code for " + std::to_string((now - began) / 1'000'000) + " ms");
  }
}

void Scheduler::set_limit(Executors& executors, int limit) {
  ReadyList freed = executors.set_limit(limit);
  hand_over(freed);
}

// Waiting, and lanes for callers.

bool Scheduler::wait_idle(std::chrono::steady_clock::time_point deadline, const std::function<bool()>& condition) {
  std::unique_lock lock(mutex_);
  waited_for_.store(true);
  return changed_.wait_until(lock, deadline, [&] { return idle() && condition(); });
}

Lane* Scheduler::borrow_lane() {
  const std::lock_guard lock(mutex_);
  if (unused_.empty()) {
    lanes_.push_back(new_lane());
    return lanes_.back().get();
  }
  Lane* lane = unused_.back();
  unused_.pop_back();
  return lane;
}

void Scheduler::return_lane(Lane* lane) {
  const std::lock_guard lock(mutex_);
  unused_.push_back(lane);
}

}  // namespace iotcloud::topology::internal
