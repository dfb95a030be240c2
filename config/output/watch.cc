#include <algorithm>
#include <csignal>
#include <ostream>
#include <thread>

#include <unistd.h>

#include <iotcloud/config/output/watch.h>

namespace iotcloud::config::output {

namespace {

volatile std::sig_atomic_t interrupted = 0;

}  // namespace

void interrupt() {
  interrupted = 1;
}

bool pause(std::chrono::duration<double> time) {
  using Seconds = std::chrono::duration<double>;
  const auto until = std::chrono::steady_clock::now() + time;
  while (interrupted == 0 && std::chrono::steady_clock::now() < until)
    std::this_thread::sleep_for(std::min<Seconds>(until - std::chrono::steady_clock::now(), Seconds(0.05)));
  return interrupted == 0;
}

int watch(std::ostream& out, Format format, double seconds, const std::function<int()>& once) {
  const bool again = seconds > 0;
  int status = 0;
  do {
    if (again && format == Format::table && isatty(STDOUT_FILENO) == 1) out << "\033[H\033[2J";
    if (again && format == Format::yaml) out << "---\n";
    status = once();
    if (again && format == Format::table) out << '\n';
    out.flush();
  } while (again && out && pause(std::chrono::duration<double>(seconds)));
  return status;
}

}  // namespace iotcloud::config::output
