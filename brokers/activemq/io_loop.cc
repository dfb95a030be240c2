#include "iotcloud/brokers/activemq/io_loop.h"

#include <algorithm>
#include <utility>

#include <poll.h>
#include <pthread.h>

namespace iotcloud::brokers::activemq {
namespace {

// How often the standing-by thread checks whether handlers run long. So they keep the sockets waiting for one to two of
// these periods.
constexpr std::chrono::milliseconds look_every{10};
// After this many checks without handlers the standing-by thread sleeps until handlers run again.
constexpr int looks_in_vain = 100;

thread_local const IoLoop* gathering = nullptr;

}  // namespace

void IoLoop::start(std::vector<Service*> services) {
  const config::MutexLock lock(mutex_);
  if (!threads_.empty() || ending_) return;
  services_ = std::move(services);
  begin_thread();
  begin_thread();
}

void IoLoop::begin_thread() {
  threads_.emplace_back([this] { run(); });
  pthread_setname_np(threads_.back().native_handle(), "amqp10-io");
}

void IoLoop::stop() {
  std::vector<std::thread> threads;
  {
    const config::MutexLock lock(mutex_);
    ending_ = true;
    threads.swap(threads_);
    changed_.notify_all();
  }
  event_.signal();
  for (std::thread& thread : threads) thread.join();
}

void IoLoop::wake() {
  if (!serves()) event_.signal();
}

void IoLoop::gather(bool on) {
  gathering = on ? this : nullptr;
}

bool IoLoop::gathers() const {
  return gathering == this && serves();
}

void IoLoop::flush() {
  for (Service* const service : services_) service->flush();
}

void IoLoop::run() {
  const config::MutexLock lock(mutex_);
  while (!ending_) {
    if (server_.load() == std::thread::id()) server_ = std::this_thread::get_id();
    if (!serves()) {
      stand_by();
      continue;
    }
    const config::Unlocked unlocked(mutex_);
    flush();  // send what the previous serving thread held back
    while (serves() && !ending_) round();
  }
}

void IoLoop::stand_by() {
  changed_.wait(mutex_, [this] { return ending_ || watched_; });
  int in_vain = 0;
  while (!ending_) {
    const std::uint64_t round = rounds_;
    const std::uint64_t batch = batches_;
    if (changed_.wait_until(mutex_, clock_, clock_.now() + look_every, [this] { return ending_.load(); })) return;
    if (handler_ == server_ && rounds_ == round) {
      server_ = std::this_thread::get_id();
      return;
    }
    in_vain = batches_ == batch ? in_vain + 1 : 0;
    if (in_vain < looks_in_vain) continue;
    watched_ = false;
    if (batches_ == batch) return;
    watched_ = true;  // handlers began just now and did not wake this thread
    in_vain = 0;
  }
}

int IoLoop::wait_ms(Instant until) const {
  if (until == Instant::max()) return -1;
  const Instant now = clock_.now();
  if (until <= now) return 0;  // also for min(), which cannot be subtracted from
  const auto wait = std::chrono::ceil<std::chrono::milliseconds>(until - now);
  return static_cast<int>(std::min<std::int64_t>(wait.count(), 60'000));
}

void IoLoop::round() {
  ++rounds_;
  std::vector<pollfd> sockets{{event_.descriptor(), POLLIN, 0}};
  Instant until = Instant::max();
  bool handlers = false;
  for (Service* const service : services_) {
    const Service::Wish wish = service->wish();
    sockets.push_back({wish.socket, static_cast<short>(wish.write ? POLLIN | POLLOUT : POLLIN), 0});
    until = std::min(until, wish.at);
    handlers = handlers || service->has_handlers_to_run();
  }
  if (::poll(sockets.data(), sockets.size(), handlers ? 0 : wait_ms(until)) > 0 && sockets.front().revents != 0) {
    event_.clear();
  }
  for (std::size_t i = 0; i < services_.size(); ++i) {
    const short events = sockets[i + 1].revents;
    services_[i]->serve((events & ~POLLOUT) != 0, (events & POLLOUT) != 0);
  }
  run_handlers();
}

void IoLoop::run_handlers() {
  if (std::none_of(services_.begin(), services_.end(), [](Service* one) { return one->has_handlers_to_run(); })) return;
  const std::thread::id me = std::this_thread::get_id();
  ++batches_;
  handler_ = me;
  if (!watched_) {
    const config::MutexLock lock(mutex_);
    watched_ = true;
    changed_.notify_one();
  }
  for (Service* const service : services_) service->run_handlers();
  std::thread::id handler = me;
  handler_.compare_exchange_strong(handler, std::thread::id());
  flush();
}

}  // namespace iotcloud::brokers::activemq
