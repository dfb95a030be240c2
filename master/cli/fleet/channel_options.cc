#include <algorithm>
#include <cstdint>
#include <map>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/number.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/master/cli/fleet/channel_options.h>

namespace iotcloud::master::cli {

namespace {

/// The values that an option allows: one of these words, or a number in this range; with neither, any text that is not
/// empty.
struct Rule {
  std::vector<std::string> words;
  std::int64_t min = 0;
  std::int64_t max = 0;  ///< 0: not a number
};

constexpr std::int64_t large = 1'000'000'000;

const std::map<std::string, Rule>& rules() {
  static const std::map<std::string, Rule> all{
      {"broker", {}},
      {"capacity", {{}, 1, large}},
      {"deadline_ms", {{}, 0, large}},
      {"durable", {{"true", "false"}}},
      {"interop", {{"java"}}},
      {"keep_last", {{}, 0, large}},
      {"priority", {{}, 0, 9}},
      {"shared", {{"true", "false"}}},
      {"spool_bytes", {{}, 65'536, std::int64_t{1} << 50}},
      {"spool_fsync", {{"never", "interval", "always"}}},
      {"spool_full", {{"block", "drop_oldest"}}},
      {"when_full", {{"keep_newest", "block", "spool"}}},
  };
  return all;
}

bool is_number_from(const std::string& text, std::int64_t min, std::int64_t max) {
  const auto value = config::parse_number<std::int64_t>(text);
  return value && *value >= min && *value <= max;
}

}  // namespace

const std::vector<std::string>& channel_options() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> all;
    for (const auto& [name, rule] : rules()) all.push_back(name);
    return all;
  }();
  return names;
}

std::string channel_option_problem(const std::string& option, const std::string& value) {
  const auto found = rules().find(option);
  if (found == rules().end()) {
    const auto near = config::nearest(option, channel_options());
    return fmt::format("\"{}\" is no option of a channel; {}", option,
                       near.empty() ? fmt::format("they are {}", fmt::join(channel_options(), ", "))
                                    : fmt::format("did you mean \"{}\"?", near));
  }
  const auto& [words, min, max] = found->second;
  if (max > 0) {
    if (is_number_from(value, min, max)) return "";
    return fmt::format("\"{}\" does not fit {}: a whole number from {} to {} is expected", value, option, min, max);
  }
  if (words.empty() ? !value.empty() : std::find(words.begin(), words.end(), value) != words.end()) return "";
  if (words.empty()) return fmt::format("{} must not be empty", option);
  return fmt::format("\"{}\" does not fit {}: use {}", value, option, fmt::join(words, ", "));
}

std::string spool_option_problem(const std::string& option, const std::string& when_full) {
  // A driver may ask for a spool by itself, so the option is fine unless the deployment sets another when_full.
  if (!option.starts_with("spool_") || when_full.empty() || when_full == "spool") return "";
  return fmt::format("{} says how the channel is spooled, but when_full is {}: set when_full to spool", option,
                     when_full);
}

std::string channel_property(const std::string& channel, const std::string& option) {
  return fmt::format("channel.{}.{}", channel, option);
}

std::string channel_setting_problem(const std::string& setting, const std::string& value) {
  const auto dot = setting.rfind('.');
  if (dot == 0 || dot == std::string::npos) return fmt::format("\"{}\" is not of the form CHANNEL.OPTION", setting);
  return channel_option_problem(setting.substr(dot + 1), value);
}

}  // namespace iotcloud::master::cli
