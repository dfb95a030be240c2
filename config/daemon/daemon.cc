#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include <CLI/CLI.hpp>
#include <pthread.h>
#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "iotcloud/config/daemon/service_manager.h"
#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/memory.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/config/version.h>
#include <iotcloud/config/yaml/asked_keys.h>

namespace iotcloud::config {

namespace {

enum ExitStatus { exit_ok = 0, exit_failed = 1, exit_usage = 2 };

sigset_t awaited_signals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGTERM);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGHUP);
  return set;
}

/// \param limit zero: no limit. \return the signal; 0 if none came in time.
int await_signal(const sigset_t& signals, std::chrono::microseconds limit) {
  for (;;) {
    const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(limit);
    const timespec wait{seconds.count(), std::chrono::nanoseconds(limit - seconds).count()};
    const int received = limit.count() > 0 ? sigtimedwait(&signals, nullptr, &wait) : sigwaitinfo(&signals, nullptr);
    if (received > 0) return received;
    if (errno == EAGAIN) return 0;  // on EINTR (a debugger attached) wait again
  }
}

/// Handles SIGHUP. A configuration with errors changes nothing; what the service cannot read again stays as it was.
void read_again(const std::string& file, DaemonService& service, const Logger& log) {
  try {
    const LogSettings settings = load_log_settings(file);
    apply(settings);
  } catch (const std::exception& error) {
    log.error("SIGHUP received, and nothing changes: {}", error.what());
    return;
  }
  try {
    service.reload();
    log.info("SIGHUP received: read the section \"log\" of {} again; the rest of it takes a restart", file);
  } catch (const std::exception& error) {
    log.error("SIGHUP received, but what cannot be read again stays as it was: {}", error.what());
  }
}

/// Reads how to log. If that fails, the service's own reader says all errors of the file.
LogSettings first_log_settings(const std::string& file, const DaemonOptions& options) {
  try {
    return load_log_settings(file);
  } catch (const ConfigError&) {
    static_cast<void>(options.build(file));
    throw;
  }
}

/// Ends the process when stopping exceeds the limit: a service that hangs cannot be asked to end.
class StopWatchdog {
 public:
  StopWatchdog(std::string name, std::chrono::milliseconds limit)
      : thread_([this, name = std::move(name), limit] {
          const MutexLock lock(mutex_);
          if (stopped_.wait_for(mutex_, limit, [this]() IOTCLOUD_REQUIRES(mutex_) { return done_; })) return;
          log_line(LogLevel::error, name, "did not stop within its limit; ending at once");
          _exit(exit_failed);
        }) {}
  ~StopWatchdog() {
    {
      const MutexLock lock(mutex_);
      done_ = true;
    }
    stopped_.notify_all();
    thread_.join();
  }

 private:
  Mutex mutex_;
  ConditionVariable stopped_;
  bool done_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::thread thread_;  // last, because it uses the other members
};

/// While it lives, SIGTERM and SIGINT ask a service that starts to stop; a second one ends the process at once.
class SignalsOfStart {
 public:
  SignalsOfStart() {
    sigset_t before, end;
    sigemptyset(&end);
    sigaddset(&end, end_signal);
    pthread_sigmask(SIG_BLOCK, &end, &before);  // the thread inherits this, so that the signal waits for it
    thread_ = std::thread([this] { listen(); });
    pthread_sigmask(SIG_SETMASK, &before, nullptr);
  }
  ~SignalsOfStart() { end(); }

  std::stop_token token() const { return stop_.get_token(); }
  /// Listens no longer. \return the signal that came; 0 if none did.
  int end() {
    if (thread_.joinable()) {
      pthread_kill(thread_.native_handle(), end_signal);
      thread_.join();
    }
    return received_;
  }

 private:
  static constexpr int end_signal = SIGUSR1;

  void listen() {
    sigset_t signals;
    sigemptyset(&signals);
    for (const int each : {SIGTERM, SIGINT, end_signal}) sigaddset(&signals, each);
    for (;;) {
      const int received = await_signal(signals, {});
      if (received == end_signal) return;
      if (received_ != 0) _exit(exit_failed);
      received_ = received;
      stop_.request_stop();
    }
  }

  std::stop_source stop_;
  int received_ = 0;  ///< read when the thread has ended
  std::thread thread_;
};

/// From now on a second signal ends the process at once.
void end_at_second_signal() {
  struct sigaction action {};
  action.sa_handler = [](int) { _exit(exit_failed); };
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  sigset_t set = awaited_signals();
  sigdelset(&set, SIGHUP);
  pthread_sigmask(SIG_UNBLOCK, &set, nullptr);
}

}  // namespace

int run_daemon(int argc, char** argv, const DaemonOptions& options) {
  const sigset_t signals = awaited_signals();
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  signal(SIGPIPE, SIG_IGN);
  keep_freed_memory();

  CLI::App app{options.description, options.name};
  std::string file, level, format;
  bool check_only = false, list_keys = false;
  app.add_option("--config", file, "the configuration file (YAML)")->required();
  app.add_flag("--check-config", check_only, "read and check the configuration, say what is wrong, and end");
  app.add_flag("--list-keys", list_keys,
               "check the configuration, print each key that such a file may have (JSON), and end: those inside of "
               "mappings that this file has");
  app.add_option("--log-level", level,
                 "debug, info, warn, error or off; without it what the file says (log: {level: ...}), or info");
  app.add_option("--log-format", format,
                 "text, or json: an object on each line; without it what the file says (log: {format: ...}), or text");
  double stop_limit_s = static_cast<double>(options.stop_limit.count()) / 1000;
  app.add_option(
         "--stop-limit", stop_limit_s,
         "the longest time in seconds from SIGTERM to the end of the process; what is not done by then is given up")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
  bool debuggable = false;
  app.add_flag("--debuggable", debuggable,
               "let other processes of this user attach to this one, read its memory and its environment, and let it "
               "dump core");
  app.set_version_flag("--version", options.name + " " + version);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? exit_ok : exit_usage;
  }

  // Passwords and keys are in the memory of a daemon, and foreign code may run as its user: a driver in its host.
  prctl(PR_SET_DUMPABLE, debuggable ? 1 : 0, 0, 0, 0);

  const Logger log{options.name};
  std::unique_ptr<DaemonService> service;
  std::vector<AskedKey> keys;
  if (list_keys) record_asked_keys(&keys);
  try {
    LogSettings settings = first_log_settings(file, options);
    if (!level.empty()) settings.level = parse_log_level(level);
    if (!format.empty()) settings.format = parse_log_format(format);
    apply(settings);
    service = options.build(file);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s: %s\n", options.name.c_str(), e.what());
    return exit_usage;
  }
  if (list_keys) {
    std::printf("%s\n", as_json(keys).c_str());
    return exit_ok;
  }
  if (check_only) {
    std::printf("%s: the configuration is good\n", file.c_str());
    return exit_ok;
  }

  const ServiceManager manager;
  int received = 0;
  try {
    SignalsOfStart during_start;
    service->start(during_start.token());
    received = during_start.end();
  } catch (const std::exception& e) {
    log.error("cannot start: {}", e.what());
    return exit_failed;
  }
  if (received == 0) {
    log.info("ready");
    manager.ready();
  }
  while (received == 0 || received == SIGHUP) {
    received = await_signal(signals, manager.period());
    if (received == 0) {
      const std::string trouble = service->trouble();
      manager.alive(trouble.empty() ? "running" : "running; " + trouble);
    } else if (received == SIGHUP) {
      manager.reloading();
      read_again(file, *service, log);
      manager.ready();
    }
  }
  manager.stopping();
  log.info("{} received, stopping", received == SIGTERM ? "SIGTERM" : "SIGINT");
  end_at_second_signal();

  // The service gets nine tenths of the limit, its destructor the rest. At the limit the process ends.
  const std::chrono::milliseconds stop_limit(std::llround(stop_limit_s * 1000));
  const StopWatchdog watchdog(options.name, stop_limit);
  try {
    service->stop(stop_limit * 9 / 10);
    service.reset();
  } catch (const std::exception& e) {
    log.error("did not stop in order: {}", e.what());
    return exit_failed;
  }
  log.info("stopped");
  return exit_ok;
}

}  // namespace iotcloud::config
