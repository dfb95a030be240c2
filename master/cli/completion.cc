#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <future>
#include <iostream>
#include <set>
#include <sstream>

#include <CLI/CLI.hpp>

#include <iotcloud/master/cli/completion.h>
#include <iotcloud/master/cli/names.h>

namespace iotcloud::master::cli {

namespace {

constexpr std::chrono::milliseconds patience{1000};

constexpr const char* bash_script =
    R"(# Completion of iotcloud for bash. In ~/.bashrc: source <(iotcloud completion bash)
_iotcloud() {
  mapfile -t COMPREPLY < <("$1" __complete "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null)
  if [ "${COMPREPLY[0]-}" = :files ]; then
    COMPREPLY=()
    compopt -o default
  fi
}
complete -F _iotcloud iotcloud
)";

constexpr const char* zsh_script = R"(#compdef iotcloud
# Completion of iotcloud for zsh. In ~/.zshrc, after compinit: source <(iotcloud completion zsh)
# Or as the file _iotcloud in a folder of $fpath, which zsh then reads at the first completion.
_iotcloud() {
  local -a found
  found=("${(@f)$("${words[1]}" __complete "${(@)words[2,CURRENT]}" 2>/dev/null)}")
  if [[ "${found[1]}" == :files ]]; then
    _files
  elif [[ -n "${found[1]}" ]]; then
    compadd -a found
  fi
}
if [[ "${funcstack[1]}" == _iotcloud ]]; then
  _iotcloud "$@"
else
  compdef _iotcloud iotcloud
fi
)";

/// Where the last word stands.
struct Place {
  const CLI::App* app = nullptr;
  const CLI::Option* value_of = nullptr;  ///< an option that awaits its value
  std::size_t positionals = 0;            ///< that stand there already
  std::vector<std::string> global;        ///< options of the program itself with their values
};

bool takes_value(const CLI::Option& option) {
  return option.get_items_expected_max() > 0;
}

/// An option of this verb, or of one above it. \param word "--state", "-o"
const CLI::Option* find_option(const CLI::App* app, const std::string& word) {
  for (; app != nullptr; app = app->get_parent()) {
    if (const auto* option = app->get_option_no_throw(word)) return option;
  }
  return nullptr;
}

const CLI::App* find_verb(const CLI::App* app, const std::string& word) {
  for (const auto* verb : app->get_subcommands([](const CLI::App*) { return true; })) {
    if (verb->get_name() == word) return verb;
  }
  return nullptr;
}

/// Walks over all words but the last.
Place place_of_last(const CLI::App& root, const std::vector<std::string>& words) {
  Place place;
  place.app = &root;
  const auto options = root.get_options();
  const auto is_global = [&](const CLI::Option* option) {
    return std::find(options.begin(), options.end(), option) != options.end();
  };
  for (std::size_t i = 0; i + 1 < words.size(); ++i) {
    const auto& word = words[i];
    if (place.value_of != nullptr) {
      if (word == "=") continue;  // bash takes --option=value apart
      if (is_global(place.value_of)) place.global.push_back(word);
      place.value_of = nullptr;
      continue;
    }
    if (word.size() > 1 && word.front() == '-') {
      const auto equals = word.find('=');
      const bool is_long = word.starts_with("--");
      const auto* option = find_option(place.app, is_long ? word.substr(0, equals) : word.substr(0, 2));
      if (option == nullptr || !takes_value(*option)) continue;
      const bool value_follows = is_long ? equals == std::string::npos : word.size() == 2;
      if (is_global(option)) place.global.push_back(word);
      if (value_follows) place.value_of = option;
      continue;
    }
    const auto* verb = place.positionals == 0 ? find_verb(place.app, word) : nullptr;
    if (verb != nullptr) {
      place.app = verb;
    } else {
      ++place.positionals;
    }
  }
  return place;
}

using Names = std::function<std::vector<std::string>(NameKind)>;

/// What can be the value of an option or of a word without one.
std::vector<std::string> values(const CLI::Option& option, const Names& names) {
  const auto type = option.get_type_name();
  const auto open = type.find('{');
  if (open != std::string::npos) {
    std::vector<std::string> choices;
    std::istringstream list(type.substr(open + 1, type.rfind('}') - open - 1));
    for (std::string choice; std::getline(list, choice, ',');) choices.push_back(choice);
    return choices;
  }
  const auto is = [&](const std::string& word) {
    return type == word || option.get_name(true, false) == word || option.get_name(true, false).starts_with(word + " ");
  };
  if (is("FILE") || is("DIR") || is("PLUGIN") || is("KEY")) return {":files"};
  if (is("GATEWAY")) return names(NameKind::gateways);
  if (is("ID")) return names(NameKind::instances);
  if (is("DRIVER")) return names(NameKind::drivers);
  if (is("NAME")) return names(NameKind::deployments);
  if (is("TOPOLOGY")) return names(NameKind::topologies);
  return {};
}

/// Those that go on where the word ends. \param kept stands before each of them.
std::vector<std::string> fitting(const std::vector<std::string>& words, const std::string& begun,
                                 const std::string& kept = "") {
  if (words == std::vector<std::string>{":files"}) return words;
  std::set<std::string> all;
  for (const auto& word : words) {
    if (!word.empty() && word.starts_with(begun)) all.insert(kept + word);
  }
  return {all.begin(), all.end()};
}

std::vector<std::string> value_words(const CLI::Option& option, const std::string& begun, const std::string& kept,
                                     const Names& names) {
  const auto comma = option.get_delimiter() == ',' ? begun.rfind(',') : std::string::npos;
  if (comma == std::string::npos) return fitting(values(option, names), begun, kept);
  return fitting(values(option, names), begun.substr(comma + 1), kept + begun.substr(0, comma + 1));
}

std::vector<std::string> option_words(const CLI::App* app, const std::string& begun) {
  std::vector<std::string> all;
  for (; app != nullptr; app = app->get_parent()) {
    for (const auto* option : app->get_options()) {
      for (const auto& name : option->get_lnames()) all.push_back("--" + name);
      if (!option->get_lnames().empty() || begun == "-") continue;
      for (const auto& name : option->get_snames()) all.push_back("-" + name);
    }
  }
  return fitting(all, begun);
}

std::vector<std::string> candidates(const Place& place, std::string last, const Names& names) {
  if (place.value_of != nullptr) return value_words(*place.value_of, last == "=" ? "" : last, "", names);
  if (last.starts_with("-")) {
    const auto equals = last.find('=');
    if (equals == std::string::npos) return option_words(place.app, last);
    const auto* option = find_option(place.app, last.substr(0, equals));
    if (option == nullptr) return {};
    return value_words(*option, last.substr(equals + 1), last.substr(0, equals + 1), names);
  }
  std::vector<std::string> verbs;
  for (const auto* verb : place.app->get_subcommands([](const CLI::App*) { return true; }))
    verbs.push_back(verb->get_name());
  if (!verbs.empty()) return place.positionals == 0 ? fitting(verbs, last) : std::vector<std::string>{};
  std::size_t number = 0;
  for (const auto* option : place.app->get_options()) {
    if (!option->get_positional()) continue;
    const auto most = static_cast<std::size_t>(option->get_items_expected_max());
    if (place.positionals < number + most) return value_words(*option, last, "", names);
    number += most;
  }
  return {};
}

}  // namespace

void add_completion(CLI::App& app, Words& words) {
  auto& sub = *app.add_subcommand("completion", "Print what makes a shell complete this command's words");
  sub.add_option("SHELL", words.shell, "the shell")->required()->check(CLI::IsMember({"bash", "zsh"}));
  sub.footer("Example:\n  source <(iotcloud completion bash)");
}

int print_completion(const std::string& shell, std::ostream& out) {
  out << (shell == "bash" ? bash_script : zsh_script);
  return exit_ok;
}

int answer_shell(CLI::App& app, const std::vector<std::string>& words, const std::function<Command()>& command) {
  if (words.empty()) return exit_ok;
  const auto place = place_of_last(app, words);
  const auto names = [&](NameKind kind) -> std::vector<std::string> {
    try {
      auto global = place.global;
      global.push_back("status");  // the program wants a verb
      std::reverse(global.begin(), global.end());
      app.parse(global);
      auto answer = std::async(std::launch::async, [kind, made = command()] { return names_of(kind, made); });
      if (answer.wait_for(patience) == std::future_status::ready) return answer.get();
    } catch (const std::exception&) {
      return {};  // a shell has no place for complaints
    }
    std::cout.flush();
    std::_Exit(exit_ok);
  };
  for (const auto& word : candidates(place, words.back(), names)) std::cout << word << '\n';
  return exit_ok;
}

}  // namespace iotcloud::master::cli
