// iotcloud-run: a topology and its drivers in one process; `iotcloud run` starts it.
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <future>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <signal.h>
#include <unistd.h>

#include <iotcloud/config/log_settings.h>
#include <iotcloud/topology/local/local_console.h>
#include <iotcloud/topology/local/local_run.h>
#include <iotcloud/topology/local/recent_lines.h>
#include <iotcloud/topology/local/watched_files.h>

namespace {

using namespace iotcloud;

/// How a run is shown and ends.
struct Wanted {
  int seconds = 0;                 ///< after which it ends; 0: at a signal only
  std::string view;                ///< where the console is served; empty: nowhere
  std::vector<std::string> pages;  ///< folders of robots' pages for it
  double stop_limit_s = 5;
  std::chrono::milliseconds stop_limit() const { return std::chrono::milliseconds(std::llround(stop_limit_s * 1000)); }
};

void print(const std::vector<std::string>& lines) {
  for (const auto& line : lines) std::printf("%s\n", line.c_str());
  std::fflush(stdout);
}

/// Blocks the signals that end the process before any thread exists, so that run() alone gets them.
sigset_t ending_signals() {
  sigset_t ending;
  sigemptyset(&ending);
  sigaddset(&ending, SIGINT);
  sigaddset(&ending, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &ending, nullptr);
  return ending;
}

/// Set in a process that began anew because a file changed.
constexpr const char* again_variable = "IOTCLOUD_RUN_AGAIN";
constexpr timespec second{1, 0};
/// What run() and wait_for_change() return when a file has changed; other values are exit statuses.
constexpr int file_changed = -1;

/// Starts on another thread, so that a signal also ends a start that waits (for a driver that hangs in open(), say).
/// \return nullptr: a signal has ended it.
std::unique_ptr<local::LocalRun> start(const local::RunOptions& options, std::chrono::milliseconds stop_limit,
                                       const sigset_t& ending) {
  constexpr timespec moment{0, 20'000'000};
  std::stop_source end;
  auto started =
      std::async(std::launch::async, [&] { return std::make_unique<local::LocalRun>(options, end.get_token()); });
  auto tell_at = std::chrono::steady_clock::now() + std::chrono::seconds(2);
  while (started.wait_for(std::chrono::seconds(0)) != std::future_status::ready) {
    if (sigtimedwait(&ending, nullptr, &moment) < 0) {
      if (std::chrono::steady_clock::now() < tell_at) continue;
      tell_at = std::chrono::steady_clock::time_point::max();
      std::fprintf(stderr,
                   "iotcloud-run: it waits for the registry, and then until all drivers are open; Ctrl-C ends it\n");
      continue;
    }
    end.request_stop();
    if (started.wait_for(2 * stop_limit) != std::future_status::ready) {
      std::fprintf(stderr, "iotcloud-run: the start did not end within %d s\n",
                   static_cast<int>(2 * stop_limit.count() / 1000));
      std::_Exit(1);  // whatever hangs would hinder an orderly end
    }
    try {
      started.get()->stop(stop_limit);
    } catch (const std::exception& error) {
      std::fprintf(stderr, "iotcloud-run: ended at its start: %s\n", error.what());
    }
    return nullptr;
  }
  return started.get();
}

int run(const local::RunOptions& options, const Wanted& wanted, const sigset_t& ending, local::WatchedFiles& files) {
  std::optional<local::RecentLines> lines;
  if (!wanted.view.empty()) lines.emplace();  // before the start, which the page's log is to tell, too
  const auto started = start(options, wanted.stop_limit(), ending);
  if (!started) return 0;
  local::LocalRun& running = *started;
  std::printf("%s runs; Ctrl-C ends it\n", options.topology.c_str());
  std::unique_ptr<local::LocalConsole> console;
  if (!wanted.view.empty()) {
    console = std::make_unique<local::LocalConsole>(running.cluster(), wanted.view, wanted.pages);
    std::printf("console: %s\n", console->url().c_str());
  }
  std::fflush(stdout);
  for (const auto& line : running.without_driver()) std::fprintf(stderr, "iotcloud-run: %s\n", line.c_str());
  std::string changed;
  for (int passed = 1; changed.empty() && sigtimedwait(&ending, nullptr, &second) < 0; ++passed) {
    print(running.news());
    if (passed == wanted.seconds) break;
    changed = files.changed();
  }
  if (!changed.empty()) print({changed + " changed: all starts anew"});
  console.reset();
  if (!running.stop(wanted.stop_limit())) {
    std::fprintf(stderr, "iotcloud-run: not everything stopped within %g s (--stop-limit)\n", wanted.stop_limit_s);
    if (changed.empty()) return 1;
  }
  return changed.empty() ? 0 : file_changed;
}

int wait_for_change(const sigset_t& ending, local::WatchedFiles& files) {
  std::fprintf(stderr, "iotcloud-run: waiting for a file to change; Ctrl-C ends it\n");
  while (sigtimedwait(&ending, nullptr, &second) < 0) {
    if (!files.changed().empty()) return file_changed;
  }
  return 0;
}

/// The program begins anew in this process, because a library that was loaded cannot be replaced. \return only when
/// that failed.
int begin_anew(char** arguments) {
  setenv(again_variable, "1", 1);
  execv("/proc/self/exe", arguments);
  std::perror("iotcloud-run: cannot begin anew");
  return 2;
}

/// The component libraries of the build and of the installation.
std::vector<std::string> library_folders() {
  const auto program = std::filesystem::read_symlink("/proc/self/exe").parent_path();
  return {program.parent_path() / "plugins", program.parent_path() / "lib/iotcloud/plugins"};
}

/// The robots' pages of the build and of the installation.
std::vector<std::string> page_folders() {
  const auto program = std::filesystem::read_symlink("/proc/self/exe").parent_path();
  return {program.parent_path() / "pages", program.parent_path() / "share/iotcloud/pages"};
}

}  // namespace

int main(int argc, char** argv) {
  signal(SIGPIPE, SIG_IGN);
  local::RunOptions options;
  Wanted wanted;
  std::vector<std::string> properties;
  std::string log_level = "warn";
  CLI::App app{"Runs a topology and drivers in one process, without a server.", "iotcloud-run"};
  app.add_option("FILE", options.topology, "the topology's YAML file")->required()->check(CLI::ExistingFile);
  app.add_option("--plugin", options.plugins, "a driver's plugin; again for each further one, all in one folder")
      ->allow_extra_args(false);
  app.add_option("-n,--count", options.count, "instances of each plugin")->check(CLI::Range(1, 10'000));
  app.add_option("--property", properties,
                 "KEY=VALUE, for all instances, {index} in it for each one's number; again for each further one")
      ->allow_extra_args(false);
  app.add_option("--broker", options.broker_url, "a broker's URL in place of the embedded one");
  app.add_option(
      "--registry", options.registry_url,
      "a registry's URL in place of the embedded one; all is below a path of the run's own there, which is removed "
      "at the end: no fleet is touched");
  app.add_option("--seconds", wanted.seconds, "end after so many; 0: with Ctrl-C");
  app.add_option("--stop-limit", wanted.stop_limit_s,
                 "the longest time in seconds from then on until all is stopped; the exit status is 1 if it is not")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
  app.add_option("--view", wanted.view,
                 "HOST:PORT of loopback, where a page shows all of it: 127.0.0.1:9114; port 0: a free one");
  app.add_option("--pages", wanted.pages, "a folder of robots' pages for --view; again for each further one")
      ->check(CLI::ExistingDirectory)
      ->allow_extra_args(false);
  app.add_option("--log-level", log_level, "debug, info, warn, error or off");
  CLI11_PARSE(app, argc, argv);
  try {
    options.library_folders = library_folders();
    for (auto& folder : page_folders()) wanted.pages.push_back(std::move(folder));
    config::set_log_level(config::parse_log_level(log_level));
    for (const auto& word : properties) {
      const auto equals = word.find('=');
      if (equals == 0 || equals == std::string::npos)
        throw config::Error("--property: \"" + word + "\" is not of the form KEY=VALUE");
      options.properties[word.substr(0, equals)] = word.substr(equals + 1);
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "iotcloud-run: %s\n", error.what());
    return 2;
  }
  const sigset_t ending = ending_signals();
  local::WatchedFiles files(local::files_of(options));
  int status = 2;
  try {
    status = run(options, wanted, ending, files);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "iotcloud-run: %s\n", error.what());
    if (getenv(again_variable) != nullptr) status = wait_for_change(ending, files);
  }
  return status == file_changed ? begin_anew(argv) : status;
}
