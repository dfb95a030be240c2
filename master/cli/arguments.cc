#include <fstream>

#include <CLI/CLI.hpp>

#include <iotcloud/master/cli/arguments.h>

namespace iotcloud::master::cli {

std::map<std::string, std::string> pairs(const std::vector<std::string>& words, const char* option) {
  std::map<std::string, std::string> out;
  for (const auto& word : words) {
    const auto equals = word.find('=');
    if (equals == 0 || equals == std::string::npos)
      throw CLI::ValidationError(option, "\"" + word + "\" is not of the form NAME=VALUE");
    if (!out.emplace(word.substr(0, equals), word.substr(equals + 1)).second)
      throw CLI::ValidationError(option, word.substr(0, equals) + " is given twice");
  }
  return out;
}

std::string first_line(const std::string& file) {
  std::ifstream in(file);
  std::string line;
  if (!std::getline(in, line)) throw CLI::ValidationError("--token-file", "cannot read a line from " + file);
  return line;
}

void add_output(CLI::App& app, Command& command) {
  app.add_option_function<std::string>(
         "-o,--output",
         [&command](const std::string& format) {
           command.format = format == "json" ? Format::json : format == "yaml" ? Format::yaml : Format::table;
         },
         "how the answer is written")
      ->check(CLI::IsMember({"table", "json", "yaml"}))
      ->type_name("FORMAT");
}

CLI::App& add(CLI::App& app, Command& command, Verb verb, const char* name, const char* what, const char* example) {
  auto& sub = *app.add_subcommand(name, what);
  sub.footer(std::string("Example:\n  ") + example);
  sub.callback([&command, verb] { command.verb = verb; });
  add_output(sub, command);
  return sub;
}

void add_gateways(CLI::App& sub, Command& command, const char* what) {
  sub.add_option("-g,--gateway", command.gateways, what)->delimiter(',')->allow_extra_args(false)->type_name("GATEWAY");
}

void add_wait(CLI::App& sub, Words& words) {
  sub.add_option("--wait", words.wait_s, "seconds to wait for the outcome; the master decides when it is not given")
      ->check(CLI::Range(0.001, 600.0))
      ->type_name("SECONDS");
}

void add_settle(CLI::App& sub, Words& words) {
  sub.add_option("--settle", words.settle_s, "seconds that those of a step must stay up before the next one")
      ->check(CLI::Range(0.0, 600.0))
      ->default_str("1")
      ->type_name("SECONDS");
}

void add_choice(CLI::App& sub, Command& command) {
  sub.add_option("--driver", command.driver, "only of this driver")->type_name("DRIVER");
  sub.add_option("--name", command.name, "only of the deployment of this name")->type_name("NAME");
  sub.add_option("--state", command.state, "only in this state")
      ->check(CLI::IsMember({"deployed", "starting", "active", "stopping", "inactive", "failed", "undeployed"}))
      ->type_name("STATE");
  sub.add_option(
         "--where", command.where,
         "only those for which it holds: site == \"lab\" and battery > 20 and within(location, 39.17, -86.52, 500 m)")
      ->type_name("EXPRESSION")
      ->check(CLI::Validator([](std::string& text) { return text.empty() ? "it is empty" : ""; }, ""));
}

}  // namespace iotcloud::master::cli
