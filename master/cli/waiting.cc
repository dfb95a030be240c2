#include <chrono>
#include <ostream>
#include <set>
#include <stdexcept>
#include <string>

#include <fmt/format.h>

#include <iotcloud/master/cli/driver_verbs.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/master/cli/waiting.h>

namespace iotcloud::master::cli {

using discovery::DriverRecord;
using discovery::DriverState;

namespace {

constexpr std::chrono::milliseconds pause_between{1000};

/// What an instance that has not settled waits for; empty: it has settled.
std::string words_of(const DriverRecord& driver) {
  switch (driver.state) {
    case DriverState::active:
    case DriverState::inactive:
    case DriverState::undeployed:
      return "";
    case DriverState::failed:
      if (!driver.starts_again) return "";
      break;
    case DriverState::ordered:
      return fmt::format("{} is ordered, and its gateway {} has not answered yet", driver.instance,
                         printable(driver.gateway));
    case DriverState::deployed:
    case DriverState::starting:
    case DriverState::stopping:
      break;
  }
  return fmt::format("{} on {} is {}{}{}", driver.instance, printable(driver.gateway), to_string(driver.state),
                     driver.reason.empty() ? "" : ": ", printable(driver.reason));
}

}  // namespace

WaitingReport::WaitingReport(const Call& call, Concerns concerns)
    : call_(call),
      concerns_(std::move(concerns)),
      asking_([this](const std::stop_token& stop) { ask_and_tell(stop); }) {}

void WaitingReport::say(const std::string& line) {
  const config::MutexLock lock(writing_);
  call_.err << line << std::flush;
}

void WaitingReport::ask_and_tell(const std::stop_token& stop) {
  config::Mutex mutex;
  config::StoppableConditionVariable end;
  std::set<std::string> told;
  const auto tell = [&](const std::string& words) {
    if (told.insert(words).second) say(fmt::format("iotcloud: waits: {}\n", words));
  };
  const config::MutexLock lock(mutex);
  while (!end.wait_for(mutex, stop, pause_between, [&] { return stop.stop_requested(); })) {
    try {
      const auto master = call_.connect();
      bool reported = false;
      for (const auto& driver : master->drivers()) {
        if (!concerns_(driver)) continue;
        reported = true;
        const std::string words = words_of(driver);
        if (!words.empty()) tell(words);
      }
      if (!reported) tell("no gateway has reported on the order yet; `iotcloud gateways` shows whether they live");
    } catch (const std::runtime_error&) {
      continue;  // the order's own connection tells of a master that does not answer
    }
  }
}

}  // namespace iotcloud::master::cli
