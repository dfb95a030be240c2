#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/runtime/scheduling/runnable.h>
#include <iotcloud/topology/runtime/scheduling/scheduler.h>
#include <iotcloud/topology/runtime/scheduling/timers.h>

namespace iotcloud::topology::internal {

namespace {

constexpr std::chrono::milliseconds watch_period{1};

int checked(int fd, const char* what) {
  if (fd < 0) {
    throw config::Error(std::string(what) + " failed: " + std::strerror(errno) +
                        "; raise the process's limit of open files (ulimit -n)");
  }
  return fd;
}

timespec as_timespec(std::chrono::nanoseconds duration) {
  timespec spec{};
  spec.tv_sec = duration.count() / 1'000'000'000;
  spec.tv_nsec = duration.count() % 1'000'000'000;
  return spec;
}

/// \param after from now; not negative. \param period 0: once.
void set_timer(int fd, std::chrono::nanoseconds after, std::chrono::nanoseconds period = {}) {
  itimerspec spec{};
  spec.it_value = as_timespec(std::max(after, std::chrono::nanoseconds(1)));
  spec.it_interval = as_timespec(period);
  timerfd_settime(fd, 0, &spec, nullptr);
}

void empty(int fd) {
  std::uint64_t count = 0;
  while (read(fd, &count, sizeof count) < 0 && errno == EINTR) {
  }
}

}  // namespace

Timers::Timers(const config::Clock& clock, bool clock_is_real)
    : clock_(clock),
      clock_is_real_(clock_is_real),
      alarm_fd_(checked(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK), "timerfd_create")),
      watch_fd_(checked(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK), "timerfd_create")),
      round_fd_(checked(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK), "timerfd_create")),
      stop_fd_(checked(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK), "eventfd")) {}

Timers::~Timers() {
  stop();
  for (const int fd : {alarm_fd_, watch_fd_, round_fd_, stop_fd_}) close(fd);
}

void Timers::start(Scheduler& watched, std::chrono::milliseconds round_period, std::function<void()> round) {
  watched_ = &watched;
  round_ = std::move(round);
  set_timer(round_fd_, round_period, round_period);
  thread_ = std::jthread([this] { run(); });
}

void Timers::stop() {
  if (!thread_.joinable()) return;
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto written = write(stop_fd_, &one, sizeof one);
  thread_.join();
}

void Timers::add(config::Clock::Instant due, Runnable& task, std::uint32_t bits, std::chrono::nanoseconds period) {
  const config::MutexLock lock(mutex_);
  heap_.push_back({due, &task, bits, period});
  std::push_heap(heap_.begin(), heap_.end());
  if (heap_.front().due == due) set_alarm(due);
}

void Timers::end_periodic() {
  const config::MutexLock lock(mutex_);
  std::erase_if(heap_, [](const Timer& timer) { return timer.period.count() > 0; });
  std::make_heap(heap_.begin(), heap_.end());
}

void Timers::set_alarm(config::Clock::Instant due) {
  if (clock_is_real_) set_timer(alarm_fd_, due - clock_.now());
}

void Timers::run_due() {
  const config::MutexLock lock(mutex_);
  const auto now = clock_.now();
  while (!heap_.empty() && heap_.front().due <= now) {
    std::pop_heap(heap_.begin(), heap_.end());
    const Timer timer = heap_.back();
    heap_.pop_back();
    if (timer.period.count() > 0) {
      // a periodic timer that missed several periods is signalled once
      const auto missed = (now - timer.due) / timer.period;
      heap_.push_back({timer.due + (missed + 1) * timer.period, timer.task, timer.bits, timer.period});
      std::push_heap(heap_.begin(), heap_.end());
    }
    timer.task->signal(timer.bits);
  }
  if (!heap_.empty()) set_alarm(heap_.front().due);
}

void Timers::watch() {
  if (watching_.load(std::memory_order_relaxed) || watching_.exchange(true)) return;
  set_timer(watch_fd_, watch_period);
}

void Timers::run() {
  std::array<pollfd, 4> fds{
      {{stop_fd_, POLLIN, 0}, {alarm_fd_, POLLIN, 0}, {watch_fd_, POLLIN, 0}, {round_fd_, POLLIN, 0}}};
  while (true) {
    if (poll(fds.data(), fds.size(), -1) < 0) continue;
    if (fds[0].revents != 0) return;
    if (fds[1].revents != 0) {
      empty(alarm_fd_);
      run_due();
    }
    if (fds[2].revents != 0) {
      empty(watch_fd_);
      watching_.store(false);
      if (watched_->offload_stuck_threads()) watch();
    }
    if (fds[3].revents != 0) {
      empty(round_fd_);
      round_();
    }
  }
}

}  // namespace iotcloud::topology::internal
