#pragma once

#include <map>
#include <string>
#include <vector>

#include <iotcloud/master/cli/command.h>

namespace CLI {
class App;
}

/// What the verbs' command lines have in common. Used by the program's own sources only: CLI11 is heavy.
namespace iotcloud::master::cli {

/// What the command line is parsed into before it becomes a Command.
struct Words {
  std::vector<std::string> properties;
  std::vector<std::string> metadata;
  std::vector<std::string> channels;
  std::vector<std::string> description;
  std::string token_file;
  bool all = false;
  bool undo = false;
  std::string shell;
  double wait_s = 0;
  std::vector<std::string> parallelism;
  double drain_s = 10;
  double settle_s = 1;
};

/// "k=v" words into a map. \throws CLI::ValidationError
std::map<std::string, std::string> pairs(const std::vector<std::string>& words, const char* option);
/// \throws CLI::ValidationError
std::string first_line(const std::string& file);

/// A verb, with the option --output and an example.
CLI::App& add(CLI::App& app, Command& command, Verb verb, const char* name, const char* what, const char* example);
void add_output(CLI::App& app, Command& command);
void add_gateways(CLI::App& sub, Command& command, const char* what);
void add_wait(CLI::App& sub, Words& words);
/// For verbs that update drivers step by step.
void add_settle(CLI::App& sub, Words& words);
/// What chooses drivers by what they are.
void add_choice(CLI::App& sub, Command& command);

}  // namespace iotcloud::master::cli
