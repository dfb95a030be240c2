#pragma once

#include <memory>
#include <string>

#include <nlohmann/json_fwd.hpp>

namespace iotcloud::master {

/// Answers looks at the channels of a simulated turtle that follows a person: kinect and control, as a driver host
/// would. Each look at kinect without payloads moves the world on by a quarter of a second. Thread safe.
class SimulatedTurtle {
 public:
  SimulatedTurtle();
  ~SimulatedTurtle();
  /// \param look the arguments of the console's call. \return its answer
  std::string look(const nlohmann::json& look);

 private:
  struct Impl;
  const std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
