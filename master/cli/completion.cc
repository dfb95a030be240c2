#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <future>
#include <map>
#include <ostream>
#include <set>
#include <sstream>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <iotcloud/config/declaration.h>
#include <iotcloud/master/cli/completion.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>

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
  elif [[ "${COMPREPLY[0]-}" == *= ]]; then
    compopt -o nospace
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
  elif [[ "${found[1]}" == *= ]]; then
    compadd -S '' -a found
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

/// What the words before the last one mean for the last one.
struct Place {
  const CLI::App* app = nullptr;
  const CLI::Option* value_of = nullptr;  ///< an option that awaits its value
  std::size_t positionals = 0;            ///< number of positional words before the last word
  std::string plugin;                     ///< the plugin that the verb is for, as far as the words say
  std::vector<std::string> global;        ///< options of the program itself, with their values, before the last word
};

bool takes_value(const CLI::Option& option) {
  return option.get_items_expected_max() > 0;
}

/// Finds an option of this verb or of one above it; nullptr: there is none. \param word "--state", "-o"
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

/// Reads all words but the last.
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
      if (word == "=") continue;  // bash splits --option=value into three words
      if (is_global(place.value_of)) place.global.push_back(word);
      if (place.value_of->check_name("--plugin")) place.plugin = word;
      place.value_of = nullptr;
      continue;
    }
    if (word.size() > 1 && word.front() == '-') {
      const auto equals = word.find('=');
      const bool is_long = word.starts_with("--");
      const auto* option = find_option(place.app, is_long ? word.substr(0, equals) : word.substr(0, 2));
      if (option == nullptr || !takes_value(*option)) continue;
      if (option->check_name("--plugin") && equals != std::string::npos) place.plugin = word.substr(equals + 1);
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
      if (place.app->get_option_no_throw("PLUGIN") != nullptr) place.plugin = word;
    }
  }
  return place;
}

/// Asks a master for names of one kind.
using NamesOf = std::function<std::vector<std::string>(MasterClient&)>;
using Names = std::function<std::vector<std::string>(const NamesOf&)>;

template <typename Items, typename Name>
std::vector<std::string> names_in(const Items& items, Name&& name) {
  std::vector<std::string> names;
  for (const auto& item : items) names.emplace_back(name(item));
  return names;
}

/// How a word is completed: by the name of its option's type, or by its own name when it is positional.
const std::map<std::string, NamesOf> completions{
    {"GATEWAY", [](MasterClient& m) { return names_in(m.gateways(), [](const auto& g) { return g.record.id; }); }},
    {"ID", [](MasterClient& m) { return names_in(m.drivers(), [](const auto& d) { return d.instance; }); }},
    {"DRIVER", [](MasterClient& m) { return names_in(m.drivers(), [](const auto& d) { return d.name; }); }},
    {"NAME", [](MasterClient& m) { return names_in(m.drivers(), [](const auto& d) { return d.deployment; }); }},
    {"TOPOLOGY", [](MasterClient& m) { return names_in(m.topologies(), [](const auto& t) { return t.record.name; }); }},
    {"FILE", nullptr},  // nullptr: files
    {"DIR", nullptr},
    {"PLUGIN", nullptr},
    {"KEY", nullptr},
};

/// The possible values of an option or of a positional word.
std::vector<std::string> values(const CLI::Option& option, const Names& names) {
  const auto type = option.get_type_name();
  const auto open = type.find('{');
  if (open != std::string::npos) {
    std::vector<std::string> choices;
    std::istringstream list(type.substr(open + 1, type.rfind('}') - open - 1));
    for (std::string choice; std::getline(list, choice, ',');) choices.push_back(choice);
    return choices;
  }
  const auto name = option.get_name(true, false);
  for (const auto& [word, names_of] : completions) {
    if (type != word && name != word && !name.starts_with(word + " ")) continue;
    return names_of == nullptr ? std::vector<std::string>{":files"} : names(names_of);
  }
  return {};
}

/// "rate=" for each property that the plugin declares, and "shared=true" for those with few values.
std::vector<std::string> property_words(const std::string& plugin, const Names& names) {
  const auto words_of = [](const config::DriverDeclaration& declaration) {
    std::vector<std::string> words;
    if (!declaration.properties) return words;
    for (const auto& property : *declaration.properties) {
      auto values = property.choices;
      if (property.type == "flag") values = {"true", "false"};
      if (values.empty()) words.push_back(property.name + "=");
      for (const auto& value : values) words.push_back(fmt::format("{}={}", property.name, value));
    }
    return words;
  };
  if (is_local_plugin(plugin)) {
    try {
      return words_of(config::declaration_in(plugin_bytes(plugin)));
    } catch (const std::exception&) {
      return {};  // a shell that completes a word cannot show error messages
    }
  }
  return names([&](MasterClient& master) {
    std::vector<std::string> words;
    for (const auto& [gateway, known] : master.plugins({}).plugins) {
      if (known.file != plugin) continue;
      for (auto& word : words_of(config::parse_declaration(known.declaration))) words.push_back(std::move(word));
    }
    return words;
  });
}

/// The words that begin with `begun`. \param kept is put before each of them.
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
  if (place.value_of != nullptr && place.value_of->check_name("--property") && !place.plugin.empty())
    return fitting(property_words(place.plugin, names), last);
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

class Completion final : public Verb {
 public:
  Completion()
      : Verb({"completion", "Print the script that makes a shell complete this command's words",
              "source <(iotcloud completion bash)", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    options.add_option("SHELL", shell_, "the shell")->required()->check(CLI::IsMember({"bash", "zsh"}));
  }
  int run(Call& call) override {
    call.out << (shell_ == "bash" ? bash_script : zsh_script);
    return exit_ok;
  }

 private:
  std::string shell_;
};

}  // namespace

void add_completion_verbs(Verbs& verbs) {
  verbs.add<Completion>();
}

int answer_shell(CLI::App& app, const std::vector<std::string>& words, Call& call,
                 const std::function<void()>& identify) {
  if (words.empty()) return exit_ok;
  const auto place = place_of_last(app, words);
  const auto names = [&](const NamesOf& names_of) -> std::vector<std::string> {
    try {
      auto global = place.global;
      global.push_back("status");  // the parser requires a verb
      std::reverse(global.begin(), global.end());
      app.parse(global);
      identify();
      auto answer = std::async(std::launch::async, [names_of, &call] { return names_of(*call.connect()); });
      if (answer.wait_for(patience) == std::future_status::ready) return answer.get();
    } catch (const std::exception&) {
      return {};  // a shell that completes a word cannot show error messages
    }
    call.out.flush();
    std::_Exit(exit_ok);
  };
  for (const auto& word : candidates(place, words.back(), names)) call.out << word << '\n';
  return exit_ok;
}

}  // namespace iotcloud::master::cli
