#pragma once

#include <map>
#include <string>
#include <vector>

namespace iotcloud::master::test {

/// The result of a program that has ended.
struct Finished {
  int status = -1;  ///< exit status; -1: a signal ended it
  std::string out;
  std::string err;
};

/// Runs a program until it ends. \param environment is added to this process's own.
Finished run_program(const std::vector<std::string>& words, const std::map<std::string, std::string>& environment = {});

/// A port of the loopback interface on which nobody listens now.
int free_port();

}  // namespace iotcloud::master::test
