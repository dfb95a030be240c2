#pragma once

#include <cstddef>
#include <string>
#include <vector>

/// The messages that a daemon and the other end of a ProcessStarter's socket send each other, as frames (frames.h).
/// Each end takes what the other says for input, not for truth: they run under different accounts.
namespace iotcloud::processes {

/// A daemon's request: that a process is run, or that one is killed.
struct StarterRequest {
  /// The kinds of requests.
  enum class Kind { run, kill };
  Kind kind = Kind::run;
  std::vector<std::string> arguments;    ///< of Kind::run: the process's arguments, at least one
  std::vector<std::string> environment;  ///< of Kind::run: the process's environment

  /// How many descriptors come with its first byte: log and descriptor 3 of the process; or the process to kill.
  std::size_t descriptors() const { return kind == Kind::run ? 2 : 1; }
};

/// The answer to a request. To one that runs a process there are two answers: `started`, and later `ended`.
struct StarterAnswer {
  /// The kinds of answers: an event of the process, or that the request failed.
  enum class Kind { started, ended, killed, failed };
  Kind kind = Kind::failed;
  int number = 0;      ///< of the process that was started (above 1), or how it ended, see ChildProcess::status()
  std::string reason;  ///< why it failed
};

/// Frames.
std::string encode(const StarterRequest& request);
std::string encode(const StarterAnswer& answer);
/// From a frame's body. \throws config::Error if it is none.
StarterRequest decode_request(const std::string& body);
StarterAnswer decode_answer(const std::string& body);

}  // namespace iotcloud::processes
