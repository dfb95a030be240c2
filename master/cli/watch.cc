#include <chrono>
#include <ostream>

#include <CLI/CLI.hpp>
#include <unistd.h>

#include <iotcloud/master/cli/watch.h>

namespace iotcloud::master::cli {

void WatchOption::declare(CLI::App& options) {
  options.add_option("--watch", seconds_, "again every so many seconds until interrupted; 1 when none are given")
      ->expected(0, 1)
      ->default_str("1")
      ->check(CLI::Range(0.1, 3600.0))
      ->type_name("SECONDS");
}

int WatchOption::run(Call& call, const std::function<int()>& once) const {
  int status = exit_ok;
  do {
    if (on() && call.format == Format::table && isatty(STDOUT_FILENO) == 1) call.out << "\033[H\033[2J";
    if (on() && call.format == Format::yaml) call.out << "---\n";
    status = once();
    if (on() && call.format == Format::table) call.out << '\n';
    call.out.flush();
  } while (on() && call.out && pause(std::chrono::duration<double>(seconds_)));
  return status;
}

}  // namespace iotcloud::master::cli
