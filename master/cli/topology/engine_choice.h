#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/master/cli/verb.h>

namespace CLI {
class Option;
}

namespace iotcloud::master::cli {

/// The options --engine, --nimbus and --patience of verbs that also serve topologies on Apache Storm, which the program
/// `iotcloud-storm` beside this one does.
class EngineChoice {
 public:
  /// \param without what runs the topology when no engine is given, as a text for the help
  void declare(CLI::App& options, const char* without);
  /// Refuses options for Storm where another engine is given. \throws CLI::ParseError
  void check() const;
  /// Makes another option one of those for Storm alone.
  void for_storm(const CLI::Option& option) { storms_.push_back(&option); }

  const std::string& given() const { return given_; }  ///< "pool", "storm"; empty: the command line names none
  bool storm() const { return given_ == "storm"; }
  /// Takes the engine that the topology's file names. \throws std::invalid_argument where check() would throw
  void take(const std::string& engine);

  /// Replaces this process by `iotcloud-storm` with these words, and those for Nimbus and the format.
  /// \throws config::Error when it cannot be
  [[noreturn]] void become(const Call& call, std::vector<std::string> words) const;

 private:
  /// The first option for Storm that is given without it; nullptr: none is.
  const CLI::Option* misplaced() const;

  std::string given_;
  std::vector<std::string> nimbus_;
  std::optional<int> patience_;
  std::vector<const CLI::Option*> storms_;
};

/// "--workers 3", if there is a value.
void add_word(std::vector<std::string>& words, const char* option, const std::optional<int>& value);
/// The same for a time, in whole seconds.
void add_word(std::vector<std::string>& words, const char* option, const WaitLimit& time);

}  // namespace iotcloud::master::cli
