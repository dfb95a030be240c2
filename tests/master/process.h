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

/// A program that goes on until this object ends, which interrupts it (SIGINT).
class RunningProgram {
 public:
  explicit RunningProgram(const std::vector<std::string>& words,
                          const std::map<std::string, std::string>& environment = {});
  ~RunningProgram();
  RunningProgram(const RunningProgram&) = delete;
  RunningProgram& operator=(const RunningProgram&) = delete;
  /// What it has written to stdout so far.
  std::string out() const;

 private:
  int file_ = -1;  ///< its stdout, which has no name
  int process_ = 0;
};

}  // namespace iotcloud::master::test
