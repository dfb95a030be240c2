#pragma once

#include <stdexcept>
#include <string>

namespace iotcloud::config {

/// Base of every exception that set-up code throws. The text says what went wrong, where, and how to mend it. Code of
/// the running system does not throw, but reports outcomes as values and states (see each room's interface).
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A place in a configuration file. `line` and `column` count from 1; 0 = unknown.
struct Location {
  std::string file;
  int line = 0;
  int column = 0;
};

/// A configuration that cannot be used. what() is one message:
/// "follower.yaml:7:3: spouts.kinect_receive.brokr: unknown key; did you mean \"broker\"?".
class ConfigError : public Error {
 public:
  /// \param key dotted path of the key, for example "spouts.kinect_receive.broker"; may be empty.
  /// \param problem what is wrong. \param remedy what to write instead; may be empty.
  ConfigError(const Location& where, const std::string& key, const std::string& problem, const std::string& remedy);

  const Location& where() const { return where_; }
  const std::string& key() const { return key_; }

 private:
  Location where_;
  std::string key_;
};

}  // namespace iotcloud::config
