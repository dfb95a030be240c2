#include <ostream>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

int name_silent(const std::map<discovery::GatewayId, std::string>& silent, std::string_view what, std::ostream& err) {
  for (const auto& [gateway, why] : silent)
    err << fmt::format("iotcloud: {} of {} is missing: {}\n", what, printable(gateway), printable(why));
  return silent.empty() ? exit_ok : exit_failed;
}

std::unique_ptr<MasterClient> Call::connect() const {
  return std::make_unique<MasterClient>(masters, access, election_patience);
}

Verbs::~Verbs() = default;

void Verbs::add(std::unique_ptr<Verb> verb) {
  auto& options = *app_.add_subcommand(verb->card.name, verb->card.what);
  options.footer(std::string("Example:\n  ") + verb->card.example);
  if (verb->card.answers) {
    options
        .add_option_function<std::string>(
            "-o,--output",
            [&format = format_](const std::string& word) {
              format = word == "json" ? Format::json : word == "yaml" ? Format::yaml : Format::table;
            },
            "how the answer is written")
        ->check(CLI::IsMember({"table", "json", "yaml"}))
        ->type_name("FORMAT");
  }
  verb->declare(options);
  verbs_.emplace_back(&options, std::move(verb));
}

Verbs& Verbs::group(const char* name, const char* what) {
  auto& group = *app_.add_subcommand(name, what);
  group.require_subcommand(1);
  return groups_.emplace_back(group, format_);
}

Verb* Verbs::chosen() const {
  for (const auto& [options, verb] : verbs_) {
    if (options->parsed()) return verb.get();
  }
  for (const auto& group : groups_) {
    if (auto* verb = group.chosen()) return verb;
  }
  return nullptr;
}

std::vector<const Verb*> Verbs::all() const {
  std::vector<const Verb*> all;
  for (const auto& [options, verb] : verbs_) all.push_back(verb.get());
  for (const auto& group : groups_) {
    const auto below = group.all();
    all.insert(all.end(), below.begin(), below.end());
  }
  return all;
}

}  // namespace iotcloud::master::cli
