#include <array>
#include <utility>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/processes/unix_socket.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/pooled_worker.h>

namespace iotcloud::topology {

namespace {

constexpr int look_pause_ms = 2000;  ///< the longest pause between checks of the log's size

/// The socket on which the worker of this folder listens.
processes::OwnedDescriptor listener_in(const std::string& folder, const pooled::WorkerSpec& spec) {
  if (spec.listen_on < 0) return processes::listen_in(folder, pooled::socket_name);
  processes::OwnedDescriptor given(spec.listen_on);
  fcntl(given.get(), F_SETFD, FD_CLOEXEC);
  processes::listen_on(given);
  return given;
}

}  // namespace

PooledWorker::PooledWorker(std::string folder)
    : folder_(std::move(folder)),
      spec_(pooled::read_spec(folder_)),
      log_file_({spec_.log, static_cast<std::uint64_t>(spec_.log_limit_mb) << 20, spec_.logs_kept}),
      listener_(listener_in(folder_, spec_)) {
  processes::confine(pooled::confinement_of(spec_.confinement));
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

PooledWorker::~PooledWorker() {
  thread_.request_stop();
  waker_.wake();
}

void PooledWorker::show(const pooled::WorkerReport& report) {
  const config::MutexLock lock(mutex_);
  report_ = report;
  waker_.wake();
}

void PooledWorker::probe_with(Probe probe) {
  const config::MutexLock lock(probing_);
  probe_ = std::move(probe);
}

void PooledWorker::leave_word(const std::string& folder, bool refused, const std::string& reason) noexcept try {
  const std::string path = folder + "/" + pooled::end_name;
  constexpr mode_t only_owner = 0600;
  const processes::OwnedDescriptor file(open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, only_owner));
  if (file) processes::write_all(file, pooled::encode(pooled::WorkerEnd{refused, reason}), path);
} catch (const std::exception& error) {
  pool_logger.warn("no word is left for the pool: {}", error.what());
}

void PooledWorker::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    // poll() ignores descriptor -1
    std::array<pollfd, 3> on{{{listener_.get(), POLLIN, 0}, {waker_.get(), POLLIN, 0}, {pool_.get(), POLLIN, 0}}};
    poll(on.data(), on.size(), look_pause_ms);
    if (stop.stop_requested()) return;
    try {
      log_file_.rotate_if_too_long();
      if (on[1].revents != 0) {
        waker_.clear();
        send(state());
      }
      if (on[2].revents != 0 && pool_ && !obey()) pool_.reset();
      if (on[0].revents != 0) take_pool();
    } catch (const std::exception& error) {
      pool_logger.error("the pool's connection ends: {}", error.what());
      pool_.reset();
    }
  }
}

void PooledWorker::take_pool() {
  processes::OwnedDescriptor fresh = processes::accept_from(listener_);
  if (!fresh) return;
  if (!processes::peer_may_connect(fresh, listener_)) {
    pool_logger.error("process {} of another user connected to this worker as if it were its pool; it is cut off",
                      processes::peer_process(fresh));
    return;
  }
  // A pool that looks who lives connects, and is gone when its next connection comes.
  pool_ = std::move(fresh);
  frames_ = {};
  send(state());
}

pooled::WorkerReport PooledWorker::state() {
  const config::MutexLock lock(mutex_);
  return report_;
}

void PooledWorker::send(const pooled::WorkerReport& report) {
  if (pool_ && !processes::send_all(pool_, pooled::encode(report))) pool_.reset();
}

/// \return false if the pool is gone.
bool PooledWorker::obey() {
  const auto bytes = processes::receive_some(pool_);
  if (!bytes) {
    pool_logger.warn("the pool is gone; this worker goes on and waits for it");
    return false;
  }
  frames_.feed(bytes->data(), bytes->size());
  while (const auto body = frames_.next()) {
    if (pooled::decode_command(*body).stop) {
      ::kill(getpid(), SIGTERM);  // run_daemon() stops the worker in order
      continue;
    }
    auto answer = state();
    {
      const config::MutexLock lock(probing_);
      if (probe_) probe_(answer);
    }
    send(answer);
  }
  return true;
}

}  // namespace iotcloud::topology
