#include <algorithm>
#include <stdexcept>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/master/cli/plugins/sibling_program.h>
#include <iotcloud/master/cli/topology/engine_choice.h>

namespace iotcloud::master::cli {

namespace {

constexpr const char* only_for_storm = "it is for topologies on Apache Storm: add --engine storm";

const char* word_of(Format format) {
  switch (format) {
    case Format::json:
      return "json";
    case Format::yaml:
      return "yaml";
    case Format::table:
      break;
  }
  return "table";
}

}  // namespace

void EngineChoice::declare(CLI::App& options, const char* without) {
  options
      .add_option("--engine", given_,
                  fmt::format("pool: workers of ours; storm: a cluster of Apache Storm. Without it: {}", without))
      ->check(CLI::IsMember({"pool", "storm"}))
      ->type_name("ENGINE");
  storms_ = {
      options.add_option("--nimbus", nimbus_, "with Storm: HOST:PORT of its Nimbus; several with commas")
          ->delimiter(',')
          ->allow_extra_args(false)
          ->type_name("HOST:PORT,..."),
      options
          .add_option("--patience", patience_, "with Storm: seconds in which a Nimbus must lead, after a failover, say")
          ->check(CLI::Range(0, 3600))
          ->type_name("SECONDS")};
}

const CLI::Option* EngineChoice::misplaced() const {
  const auto first =
      std::find_if(storms_.begin(), storms_.end(), [](const auto* option) { return option->count() > 0; });
  return storm() || first == storms_.end() ? nullptr : *first;
}

void EngineChoice::check() const {
  if (const CLI::Option* option = misplaced()) throw CLI::ValidationError(option->get_name(), only_for_storm);
}

void EngineChoice::take(const std::string& engine) {
  given_ = engine;
  if (const CLI::Option* option = misplaced())
    throw std::invalid_argument(fmt::format("{}: {}", option->get_name(), only_for_storm));
}

void EngineChoice::become(const Call& call, std::vector<std::string> words) const {
  if (!nimbus_.empty()) words.insert(words.end(), {"--nimbus", fmt::format("{}", fmt::join(nimbus_, ","))});
  add_word(words, "--patience", patience_);
  words.insert(words.end(), {"--output", word_of(call.format)});
  become_sibling("iotcloud-storm", words);
}

void add_word(std::vector<std::string>& words, const char* option, const std::optional<int>& value) {
  if (value) words.insert(words.end(), {option, std::to_string(*value)});
}

void add_word(std::vector<std::string>& words, const char* option, const WaitLimit& time) {
  if (time) words.insert(words.end(), {option, std::to_string(std::chrono::ceil<std::chrono::seconds>(*time).count())});
}

}  // namespace iotcloud::master::cli
