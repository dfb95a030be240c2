#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <utility>

#include <pthread.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/stream/frame_link.h>

namespace iotcloud::drivers::stream {

namespace {

constexpr int ticks_of_silence = 4;
constexpr int reads_at_once = 16;  // then other handlers of the event thread have their turn

/// As write(), without the signal that ends a process when nobody reads.
ssize_t write_quietly(int descriptor, const std::string& bytes) {
  ssize_t count = ::send(descriptor, bytes.data(), bytes.size(), MSG_NOSIGNAL);
  if (count >= 0 || errno != ENOTSOCK) return count;
  sigset_t broken_pipe, before, waiting;
  sigemptyset(&broken_pipe);
  sigaddset(&broken_pipe, SIGPIPE);
  sigpending(&waiting);
  pthread_sigmask(SIG_BLOCK, &broken_pipe, &before);
  count = ::write(descriptor, bytes.data(), bytes.size());
  const int problem = errno;
  if (count < 0 && problem == EPIPE && sigismember(&waiting, SIGPIPE) == 0) {
    const timespec at_once{};
    sigtimedwait(&broken_pipe, nullptr, &at_once);
  }
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  errno = problem;
  return count;
}

bool may_pass(int problem) {
  return problem == EAGAIN || problem == EWOULDBLOCK || problem == EINTR;
}

}  // namespace

FrameLink::FrameLink(DriverContext& context, int input, int output, Options options, Handlers handlers)
    : context_(context),
      input_(input),
      output_(output),
      options_(std::move(options)),
      handlers_(std::move(handlers)),
      decoder_(options_.framing) {
  watch_input();
  if (options_.silence.count() > 0) ticks_ = context_.every(options_.silence / ticks_of_silence, [this] { tick(); });
}

FrameLink::~FrameLink() {
  *alive_ = false;
  for (const auto& handler : {readable_, writable_, unfinished_, ticks_}) {
    if (handler) context_.stop(*handler);
  }
  close(input_);
  if (output_ != input_) close(output_);
}

void FrameLink::watch_input() {
  readable_ = context_.on_readable(input_, [this] { read(); });
}

void FrameLink::read() {
  std::array<std::byte, 16'384> buffer;
  const auto alive = alive_;
  for (int i = 0; i < reads_at_once; ++i) {
    const ssize_t count = ::read(input_, buffer.data(), buffer.size());
    if (count < 0 && may_pass(errno)) break;
    if (count <= 0) return end(count == 0 ? "it was closed" : std::strerror(errno));
    silent_ticks_ = 0;
    decoder_.feed(std::span(buffer).first(static_cast<std::size_t>(count)));
    if (!hand_over()) return;
  }
  if (*alive) watch_unfinished();
}

/// \return whether to go on reading.
bool FrameLink::hand_over() {
  const auto alive = alive_;
  try {
    for (;;) {
      if (!frame_) frame_ = decoder_.next();
      if (!frame_) return true;
      const bool taken = handlers_.on_frame(*frame_);
      if (!*alive) return false;
      if (!taken) {
        if (readable_) context_.stop(*std::exchange(readable_, std::nullopt));
        // Whole frames wait behind this one, which are not to be forgotten with an unfinished one.
        if (unfinished_) context_.stop(*std::exchange(unfinished_, std::nullopt));
        return false;
      }
      frame_.reset();
    }
  } catch (const FramingError& e) {
    end(e.what());
    return false;
  }
}

void FrameLink::resume() {
  if (!*alive_ || readable_) return;
  const auto alive = alive_;
  if (!hand_over() || !*alive) return;
  silent_ticks_ = 0;
  watch_input();
  watch_unfinished();
}

void FrameLink::watch_unfinished() {
  if (unfinished_) context_.stop(*std::exchange(unfinished_, std::nullopt));
  if (options_.frame_limit.count() == 0 || !decoder_.unfinished()) return;
  unfinished_ = context_.after(options_.frame_limit, [this] {
    unfinished_.reset();
    decoder_.reset();
  });
}

bool FrameLink::send(const std::string& bytes) {
  if (!*alive_ || !takes_ || unsent_.size() + bytes.size() > options_.most_unsent) return false;
  unsent_ += bytes;
  if (!writable_) write();
  return takes_;
}

void FrameLink::write() {
  const ssize_t count = unsent_.empty() ? 0 : write_quietly(output_, unsent_);
  if (count > 0) unsent_.erase(0, static_cast<std::size_t>(count));
  // Reading tells why.
  if (count < 0 && !may_pass(errno)) {
    takes_ = false;
    unsent_.clear();
  }
  if (unsent_.empty()) {
    if (writable_) context_.stop(*std::exchange(writable_, std::nullopt));
  } else if (!writable_) {
    writable_ = context_.on_writable(output_, [this] { write(); });
  }
}

void FrameLink::tick() {
  if (readable_ && ++silent_ticks_ >= ticks_of_silence) end("nothing was heard from it for too long");
}

void FrameLink::end(const std::string& reason) {
  if (!std::exchange(*alive_, false)) return;
  const auto on_end = handlers_.on_end;  // a copy: the callback may destroy this object
  on_end(reason);
}

}  // namespace iotcloud::drivers::stream
