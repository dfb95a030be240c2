#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/config/log.h>
#include <iotcloud/config/yaml.h>

namespace iotcloud::config {

enum class LogFormat {
  text,  ///< for people: time, level, part, text
  json,  ///< for programs: an object on each line with the members time (ISO 8601), level, part, text
};

/// How log lines are written from now on. Default: text. Thread safe.
void set_log_format(LogFormat format);
LogFormat log_format();
/// \throws ConfigError for a name that is none.
LogFormat parse_log_format(std::string_view name);

/// The section `log` of a daemon's configuration file: what SIGHUP makes it read again. What is not said stays.
struct LogSettings {
  std::optional<LogLevel> level;
  std::optional<LogFormat> format;
};

/// Reads `log: {level: debug|info|warn|error|off, format: text|json}`. Each daemon's reader of its file calls it, so
/// that the key is known there. \throws ConfigError.
LogSettings read_log_settings(Section& top);
/// The same from a file whose other keys somebody else checks. \throws ConfigError.
LogSettings load_log_settings(const std::string& file);

void apply(const LogSettings& settings);

/// The options by which a program that this process starts logs as this one does at present:
/// {"--log-level", "info", "--log-format", "json"}. Thread safe.
std::vector<std::string> log_options();

}  // namespace iotcloud::config
