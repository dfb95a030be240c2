#include <condition_variable>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <thread>

#include <CLI/CLI.hpp>
#include <pthread.h>
#include <signal.h>
#include <unistd.h>

#include <iotcloud/config/daemon.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/memory.h>
#include <iotcloud/config/version.h>

namespace iotcloud::config {

namespace {

enum ExitStatus { exit_ok = 0, exit_failed = 1, exit_usage = 2 };

sigset_t stop_signals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGTERM);
  sigaddset(&set, SIGINT);
  return set;
}

/// Ends the process when stopping takes longer than it may: what hangs cannot be asked to end.
class StopWatchdog {
 public:
  StopWatchdog(std::string name, std::chrono::milliseconds limit)
      : thread_([this, name = std::move(name), limit] {
          std::unique_lock lock(mutex_);
          if (stopped_.wait_for(lock, limit, [this] { return done_; })) return;
          log_line(LogLevel::error, name, "did not stop within its limit; ending at once");
          _exit(exit_failed);
        }) {}
  ~StopWatchdog() {
    {
      const std::lock_guard lock(mutex_);
      done_ = true;
    }
    stopped_.notify_all();
    thread_.join();
  }

 private:
  std::mutex mutex_;
  std::condition_variable stopped_;
  bool done_ = false;   // guarded by mutex_
  std::thread thread_;  // last: it uses the others
};

/// A second signal while stopping ends the process at once.
void end_at_second_signal() {
  struct sigaction action {};
  action.sa_handler = [](int) { _exit(exit_failed); };
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  const sigset_t set = stop_signals();
  pthread_sigmask(SIG_UNBLOCK, &set, nullptr);
}

}  // namespace

int run_daemon(int argc, char** argv, const DaemonOptions& options) {
  const sigset_t signals = stop_signals();
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  signal(SIGPIPE, SIG_IGN);
  keep_freed_memory();

  CLI::App app{options.description, options.name};
  std::string file, level = "info";
  bool check_only = false;
  app.add_option("--config", file, "the configuration file (YAML)")->required();
  app.add_flag("--check-config", check_only, "read and check the configuration, say what is wrong, and end");
  app.add_option("--log-level", level, "debug, info, warn, error or off")->default_val(level);
  app.set_version_flag("--version", options.name + " " + version);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? exit_ok : exit_usage;
  }

  const Logger log{options.name};
  std::unique_ptr<Service> service;
  try {
    set_log_level(parse_log_level(level));
    service = options.build(file);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s: %s\n", options.name.c_str(), e.what());
    return exit_usage;
  }
  if (check_only) {
    std::printf("%s: the configuration is good\n", file.c_str());
    return exit_ok;
  }

  try {
    service->start();
  } catch (const std::exception& e) {
    log.error("cannot start: {}", e.what());
    return exit_failed;
  }
  log.info("ready");
  int received = 0;
  sigwait(&signals, &received);
  log.info("{} received, stopping", received == SIGTERM ? "SIGTERM" : "SIGINT");
  end_at_second_signal();

  // The service has nine tenths of the limit; the rest is for its destruction. At the limit the process ends.
  const StopWatchdog watchdog(options.name, options.stop_limit);
  try {
    service->stop(options.stop_limit * 9 / 10);
    service.reset();
  } catch (const std::exception& e) {
    log.error("did not stop in order: {}", e.what());
    return exit_failed;
  }
  log.info("stopped");
  return exit_ok;
}

}  // namespace iotcloud::config
