#pragma once

#include <string>
#include <vector>

namespace iotcloud::master::cli {

/// How a program ended that was run to its end.
struct ProgramEnd {
  int status = 0;      ///< its exit status; with a signal 0
  int signal = 0;      ///< the signal that killed it; 0: none
  std::string output;  ///< what it wrote to stdout and stderr
};

/// Runs a program of ours that is installed in the same folder as this one. The command line itself links no driver
/// host and no topology. \throws config::Error that names the program when it is not there or cannot be started.
ProgramEnd run_sibling(const std::string& program, const std::vector<std::string>& arguments);

/// Runs such a program in place of this one, which is gone then. \throws config::Error as run_sibling().
[[noreturn]] void become_sibling(const std::string& program, const std::vector<std::string>& arguments);

}  // namespace iotcloud::master::cli
