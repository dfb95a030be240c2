#pragma once

#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// Keys of a component's configuration that it does not take, or not with these values. Bolt::tick_period() may throw
/// it, so that the check of a topology's file names each key's place. what() has a line for each.
class __attribute__((visibility("default"))) ConfErrors : public std::invalid_argument {
 public:
  /// \param keys what is wrong with each, and what would be right. \pre not empty
  explicit ConfErrors(std::map<std::string, std::string> keys);
  const std::map<std::string, std::string>& keys() const { return keys_; }

 private:
  std::map<std::string, std::string> keys_;
};

/// Collects what is wrong with a component's configuration, key by key.
class ConfCheck {
 public:
  /// Keeps only the first error of a key.
  void refuse(const std::string& key, const std::string& problem) { keys_.emplace(key, problem); }
  /// Refuses keys that begin with `prefix` ("window."; empty: all keys) and are not among `known`, so that a misspelt
  /// key is not silently ignored. The error names the nearest known key.
  void refuse_unknown_keys(const Config& config, const std::string& prefix, const std::vector<std::string>& known);
  /// \throws ConfErrors if there is an error.
  void finish() const;

 private:
  std::map<std::string, std::string> keys_;
};

}  // namespace iotcloud::topology
