#include <iotcloud/config/error.h>
#include <iotcloud/config/log_settings.h>

namespace iotcloud::config {

LogFormat parse_log_format(std::string_view name) {
  if (name == "text") return LogFormat::text;
  if (name == "json") return LogFormat::json;
  throw ConfigError({}, "log format", "\"" + std::string(name) + "\" is none", "use text or json");
}

LogSettings read_log_settings(YamlSection& top) {
  LogSettings settings;
  auto log = top.optional_section("log");
  if (!log) return settings;
  const std::string level = log->choice_or("level", "", {"debug", "info", "warn", "error", "off"});
  if (!level.empty()) settings.level = parse_log_level(level);
  const std::string format = log->choice_or("format", "", {"text", "json"});
  if (!format.empty()) settings.format = parse_log_format(format);
  log->finish();
  return settings;
}

LogSettings load_log_settings(const std::string& file) {
  YamlSection top = YamlSection::load_file(file);
  return read_log_settings(top);
}

void apply(const LogSettings& settings) {
  if (settings.level) set_log_level(*settings.level);
  if (settings.format) set_log_format(*settings.format);
}

std::vector<std::string> log_options() {
  std::vector<std::string> options;
  for (const auto* name : {"debug", "info", "warn", "error", "off"}) {
    if (parse_log_level(name) == log_level()) options = {"--log-level", name};
  }
  options.insert(options.end(), {"--log-format", log_format() == LogFormat::json ? "json" : "text"});
  return options;
}

}  // namespace iotcloud::config
