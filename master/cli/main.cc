#include <csignal>
#include <iostream>

#include <unistd.h>

#include <iotcloud/master/cli/program.h>

int main(int argc, char** argv) {
  std::signal(SIGPIPE, SIG_IGN);  // so a broken connection is reported as an error
  iotcloud::master::cli::Call call{std::cout, std::cerr};
  call.progress = isatty(STDERR_FILENO) != 0;
  return iotcloud::master::cli::run_program({argv + 1, argv + argc}, call);
}
