#include <atomic>
#include <exception>
#include <thread>
#include <unordered_map>
#include <utility>

#include <boost/asio/dispatch.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <fcntl.h>
#include <pthread.h>
#include <sys/prctl.h>

#include <iotcloud/config/log.h>
#include <iotcloud/gateway/host/event_loop.h>

namespace iotcloud::gateway {

namespace asio = boost::asio;

namespace {

constexpr config::Logger loop_logger{"gateway.loop"};
constexpr std::chrono::seconds catch_up_limit{1};

using Steady = std::chrono::steady_clock;

/// Runs a callback and logs its exception, because an exception must not leave the thread.
void guarded(const std::function<void()>& callback) noexcept {
  try {
    callback();
  } catch (const std::exception& e) {
    loop_logger.error("a callback threw: {}", e.what());
  } catch (...) {
    loop_logger.error("a callback threw an exception that is not a std::exception");
  }
}

}  // namespace

struct EventLoop::Impl : std::enable_shared_from_this<EventLoop::Impl> {
  struct Handler {
    virtual ~Handler() = default;
    virtual void cancel() = 0;
    bool stopped = false;
    std::function<void()> callback;
  };
  struct Timer final : Handler {
    explicit Timer(asio::io_context& context) : timer(context) {}
    void cancel() override { timer.cancel(); }
    asio::steady_timer timer;
    std::chrono::microseconds period{0};
    Steady::time_point intended;
  };
  struct Watch final : Handler {
    Watch(asio::io_context& context, int duplicate) : descriptor(context, duplicate) {}
    void cancel() override { descriptor.close(ignored); }
    asio::posix::stream_descriptor descriptor;
    boost::system::error_code ignored;
  };

  // No concurrency hint: with a hint of 1, calls that other threads post later may overtake a call that a callback
  // posts.
  asio::io_context context;
  asio::executor_work_guard<asio::io_context::executor_type> work{context.get_executor()};
  std::atomic<HandlerId> next_id{1};
  std::unordered_map<HandlerId, std::shared_ptr<Handler>> handlers;  ///< used on the loop's thread only
  std::thread thread;
  std::atomic<std::uint64_t> serving{0};
  std::atomic<std::uint64_t> ended{0};  ///< number of callbacks so far; counted on the loop's thread only
  std::atomic<bool> probe_out{false};
  std::atomic<std::uint64_t> ended_before{0};  ///< `ended` at `no_end_since`
  std::atomic<Steady::rep> no_end_since{0};

  /// Runs a callback of the loop's user.
  void run(const std::function<void()>& callback) noexcept {
    guarded(callback);
    ended.store(ended.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
  }

  void wait_timer(HandlerId id, const std::shared_ptr<Timer>& timer) {
    timer->timer.expires_at(timer->intended);
    timer->timer.async_wait([this, id, timer](const boost::system::error_code&) {
      if (timer->stopped) return;
      if (timer->period.count() == 0) handlers.erase(id);
      run(timer->callback);
      if (timer->stopped || timer->period.count() == 0) return;
      timer->intended += timer->period;
      const auto behind = Steady::now() - timer->intended;
      if (behind > catch_up_limit && behind > timer->period) {
        timer->intended += timer->period * (behind / timer->period);
      }
      wait_timer(id, timer);
    });
  }

  void wait_descriptor(const std::shared_ptr<Watch>& watch, bool for_writing) {
    const auto kind =
        for_writing ? asio::posix::stream_descriptor::wait_write : asio::posix::stream_descriptor::wait_read;
    watch->descriptor.async_wait(kind, [this, watch, for_writing](const boost::system::error_code& error) {
      if (watch->stopped) return;
      if (error) {
        loop_logger.warn("a descriptor is not watched any more: {}", error.message());
        return;
      }
      run(watch->callback);
      if (!watch->stopped) wait_descriptor(watch, for_writing);
    });
  }
};

EventLoop::EventLoop(const std::string& name) : impl_(std::make_shared<Impl>()) {
  impl_->thread = std::thread([impl = impl_, name] {
    pthread_setname_np(pthread_self(), name.substr(0, 15).c_str());
    prctl(PR_SET_TIMERSLACK, 1UL, 0UL, 0UL, 0UL);  // the default timer slack makes every sleep 50 us late
    impl->context.run();
  });
}

EventLoop::~EventLoop() {
  stop();
}

void EventLoop::stop() {
  impl_->context.stop();
  if (!impl_->thread.joinable()) return;
  if (on_this_thread()) {
    impl_->thread.detach();  // the thread's shared_ptr keeps Impl alive until the thread has left the callback
  } else {
    impl_->thread.join();
    impl_->handlers.clear();
  }
}

void EventLoop::abandon() {
  impl_->context.stop();
  if (impl_->thread.joinable()) impl_->thread.detach();
}

void EventLoop::post(std::function<void()> callback) {
  asio::post(impl_->context, [impl = impl_.get(), callback = std::move(callback)] { impl->run(callback); });
}

HandlerId EventLoop::new_handler() {
  return impl_->next_id++;
}

HandlerId EventLoop::start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                                 std::function<void()> callback, HandlerId id) {
  if (id == 0) id = new_handler();
  auto timer = std::make_shared<Impl::Timer>(impl_->context);
  timer->callback = std::move(callback);
  timer->period = period;
  timer->intended = Steady::now() + first;
  asio::dispatch(impl_->context, [impl = impl_.get(), id, timer] {
    if (timer->stopped) return;
    impl->handlers.emplace(id, timer);
    impl->wait_timer(id, timer);
  });
  return id;
}

HandlerId EventLoop::watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback, HandlerId id) {
  if (id == 0) id = new_handler();
  // A duplicate, so that the caller may close its descriptor, or watch it for reading and for writing.
  const int duplicate = fcntl(descriptor, F_DUPFD_CLOEXEC, 0);
  if (duplicate < 0) {
    loop_logger.error("descriptor {} cannot be watched: it is not open", descriptor);
    return id;
  }
  asio::dispatch(impl_->context, [impl = impl_.get(), id, duplicate, for_writing, callback = std::move(callback)] {
    try {
      auto watch = std::make_shared<Impl::Watch>(impl->context, duplicate);
      watch->callback = callback;
      impl->handlers.emplace(id, watch);
      impl->wait_descriptor(watch, for_writing);
    } catch (const std::exception& e) {
      loop_logger.error("a descriptor cannot be watched (a regular file?): {}", e.what());
    }
  });
  return id;
}

void EventLoop::stop_handler(HandlerId id) {
  asio::dispatch(impl_->context, [impl = impl_.get(), id] {
    const auto found = impl->handlers.find(id);
    if (found == impl->handlers.end()) return;
    const auto handler = std::move(found->second);
    impl->handlers.erase(found);
    handler->stopped = true;
    handler->cancel();
  });
}

bool EventLoop::on_this_thread() const {
  return impl_->thread.get_id() == std::this_thread::get_id();
}

EventLoop::Serving::Serving(EventLoop& loop, std::uint64_t whom)
    : loop_(loop), before_(loop.impl_->serving.exchange(whom, std::memory_order_relaxed)) {}

EventLoop::Serving::~Serving() {
  loop_.impl_->serving.store(before_, std::memory_order_relaxed);
}

std::uint64_t EventLoop::serving() const {
  return impl_->serving.load(std::memory_order_relaxed);
}

std::chrono::milliseconds EventLoop::stalled() {
  const auto now = Steady::now();
  const std::uint64_t ended = impl_->ended.load(std::memory_order_relaxed);
  const bool answered = !impl_->probe_out.exchange(true);
  // A loop with thousands of calls before the probe is busy, not stuck.
  const bool goes_on = impl_->ended_before.exchange(ended) != ended;
  if (answered || goes_on) impl_->no_end_since = now.time_since_epoch().count();
  if (answered) post([impl = impl_.get()] { impl->probe_out = false; });
  return std::chrono::duration_cast<std::chrono::milliseconds>(now.time_since_epoch() -
                                                               Steady::duration(impl_->no_end_since.load()));
}

}  // namespace iotcloud::gateway
