// new ...: a folder with a project that builds against the installed SDK; no master is asked
#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <ostream>
#include <set>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/start/templates.h>
#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t longest_name = 40;

/// Names that C++ or CMake have for something else.
const std::set<std::string>& reserved() {
  static const std::set<std::string> words{
      "all",     "auto",     "bool",      "break",    "case",     "catch",   "char",      "class",    "clean",
      "const",   "continue", "default",   "delete",   "do",       "double",  "else",      "enum",     "explicit",
      "export",  "extern",   "false",     "float",    "for",      "friend",  "goto",      "help",     "if",
      "inline",  "install",  "int",       "iotcloud", "long",     "mutable", "namespace", "new",      "operator",
      "package", "private",  "protected", "public",   "register", "return",  "short",     "signed",   "sizeof",
      "static",  "struct",   "switch",    "template", "test",     "this",    "throw",     "true",     "try",
      "typedef", "typename", "union",     "unsigned", "using",    "virtual", "void",      "volatile", "while"};
  return words;
}

/// \throws CLI::ValidationError.
void check_name(const std::string& name) {
  const auto fits = [](char c) {
    return std::islower(static_cast<unsigned char>(c)) != 0 || std::isdigit(static_cast<unsigned char>(c)) != 0 ||
           c == '_';
  };
  const bool good = !name.empty() && name.size() <= longest_name && std::all_of(name.begin(), name.end(), fits) &&
                    std::islower(static_cast<unsigned char>(name.front())) != 0 && name.back() != '_' &&
                    name.find("__") == std::string::npos;
  if (!good)
    throw CLI::ValidationError(
        "NAME", fmt::format("\"{}\" cannot name files, targets and a class: up to {} lower-case letters, digits "
                            "and single underscores, the first a letter (heat_pump)",
                            name, longest_name));
  if (reserved().contains(name))
    throw CLI::ValidationError("NAME",
                               fmt::format("\"{}\" means something else in C++ or CMake; take another name", name));
}

/// "heat_pump" as "HeatPump"; another class than those of the templates.
std::string class_of(const std::string& name) {
  std::string text;
  bool upper = true;
  for (const char c : name) {
    if (c != '_') text += upper ? static_cast<char>(std::toupper(static_cast<unsigned char>(c))) : c;
    upper = c == '_';
  }
  static const std::set<std::string> taken{"Driver", "Message",  "Messages", "Payload", "Direction", "Spout",
                                           "Bolt",   "Tuple",    "Fields",   "Values",  "Value",     "Config",
                                           "Spool",  "Grouping", "Shell",    "Topology"};
  return taken.contains(text) ? "My" + text : text;
}

std::string filled(std::string text, const std::string& name) {
  for (const auto& [mark, word] :
       {std::pair<std::string, std::string>{"@NAME@", name}, {"@CLASS@", class_of(name)}, {"@SDK@", "iotcloud"}}) {
    for (auto at = text.find(mark); at != std::string::npos; at = text.find(mark, at + word.size()))
      text.replace(at, mark.size(), word);
  }
  return text;
}

class New final : public Verb {
 public:
  New(const char* kind, const char* what, const char* example) : Verb({kind, what, example, std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    options.add_option("NAME", name_, "its name: lower-case letters, digits and underscores")->required();
    options.add_option("--folder", folder_, "where to make it; NAME in the present folder")->type_name("DIR");
  }
  void check() override { check_name(name_); }
  int run(Call& call) override {
    const fs::path folder = folder_.empty() ? name_ : folder_;
    std::error_code error;
    if (fs::exists(folder, error) && (!fs::is_directory(folder, error) || !fs::is_empty(folder, error)))
      throw config::Error(fmt::format(
          "{} is there already, and not empty: nothing was written; --folder names another one", folder.string()));
    fs::create_directories(folder, error);
    if (error) throw config::Error(fmt::format("{} cannot be made: {}", folder.string(), error.message()));
    for (const auto& [name, text] : templates_of(card.name)) {
      const fs::path file = folder / filled(name, name_);
      std::ofstream out(file);
      out << filled(text, name_);
      out.close();
      if (!out) throw config::Error(fmt::format("{} cannot be written: {}", file.string(), std::strerror(errno)));
    }
    call.out << fmt::format("{} is there; {}/README.md says how to build, test and run it\n", folder.string(),
                            folder.string());
    return exit_ok;
  }

 private:
  std::string name_, folder_;
};

}  // namespace

void add_new_verbs(Verbs& verbs) {
  auto& group = verbs.group("new", "Make a folder with a project that builds against the installed SDK, with its test");
  group.add<New>("driver", "A driver, a test of it with a mock host, and a manifest", "iotcloud new driver heat_pump");
  group.add<New>("bolt", "A bolt, and a test of it in simulated time", "iotcloud new bolt smooth");
  group.add<New>("topology", "A topology's file with its bolts and their test, and a manifest",
                 "iotcloud new topology alarms");
  group.add<New>("project", "A driver, and a topology that reads it and answers", "iotcloud new project greenhouse");
}

}  // namespace iotcloud::master::cli
