#include <CLI/CLI.hpp>

#include <iotcloud/master/cli/watch.h>

namespace iotcloud::master::cli {

void WatchOption::declare(CLI::App& options) {
  options.add_option("--watch", seconds_, "again every so many seconds until interrupted; 1 when none are given")
      ->expected(0, 1)
      ->default_str("1")
      ->check(CLI::Range(0.1, 3600.0))
      ->type_name("SECONDS");
}

std::vector<std::string> WatchOption::add_to(std::vector<std::string> words) const {
  if (on()) words.insert(words.end(), {"--watch", std::to_string(seconds_)});
  return words;
}

int WatchOption::run(Call& call, const std::function<int()>& once) const {
  return watch(call.out, call.format, seconds_, once);
}

}  // namespace iotcloud::master::cli
