#pragma once

#include <functional>
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

/// One key of a component's configuration (`conf` in YAML), as its class declares it. The texts are for people, in
/// Markdown: the reference (docs/reference) has them.
struct ConfKey {
  std::string name;       ///< "window.length"
  std::string value;      ///< what may stand there: "duration"
  std::string otherwise;  ///< what holds without the key: "`0s`"
  std::string text;       ///< what it is for
};

template <typename Options>
struct ConfOption;

/// Collects what is wrong with a component's configuration, key by key.
class ConfCheck {
 public:
  /// Reads all keys of a class into its options, and refuses keys that begin with `prefix` and that it does not
  /// declare.
  template <typename Options>
  void read(const Config& config, const std::string& prefix, const std::vector<ConfOption<Options>>& declared,
            Options& options) {
    std::vector<std::string> known;
    for (const auto& option : declared) {
      known.push_back(option.key.name);
      if (const auto given = config.find(option.key.name); given != config.end())
        option.read(*this, option.key.name, given->second, options);
    }
    refuse_unknown_keys(config, prefix, known);
  }
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

/// A declared key with how its value is read: what a class takes stands in one list of these, for ConfCheck::read() and
/// for the reference.
template <typename Options>
struct ConfOption {
  ConfKey key;
  /// Reads a value, or refuses it (ConfCheck::refuse()).
  std::function<void(ConfCheck& check, const std::string& name, const std::string& text, Options& options)> read;
};

/// The keys alone.
template <typename Options>
std::vector<ConfKey> keys_of(const std::vector<ConfOption<Options>>& declared) {
  std::vector<ConfKey> keys;
  keys.reserve(declared.size());
  for (const auto& option : declared) keys.push_back(option.key);
  return keys;
}

}  // namespace iotcloud::topology
