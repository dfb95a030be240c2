#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/config/log.h>
#include <iotcloud/config/yaml.h>

namespace iotcloud::config {

/// How a line is written.
enum class LogFormat {
  text,  ///< for people: time, level, part, text
  json,  ///< for programs: an object on each line with the members time (ISO 8601), level, part, text
};

/// Sets how log lines are written from now on. Default: text. Thread safe.
void set_log_format(LogFormat format);
/// How lines are written now. Thread safe.
LogFormat log_format();
/// \throws ConfigError for an unknown name.
LogFormat parse_log_format(std::string_view name);

/// Where lines go instead of stderr: called for each line on the thread that logs, several calls at a time.
using LogTarget = void (*)(LogLevel level, std::string_view part, std::string_view text) noexcept;
/// For a library in a process with a log of its own. Thread safe. \param target nullptr: stderr
void set_log_target(LogTarget target);

/// Makes the code of this project in a library, which has a log of its own, log as this process does: its level, format
/// and target, also when they change. A library without such code is left alone. Thread safe. \param library of
/// dlopen(), never unloaded
void share_log(void* library);

/// The section `log` of a daemon's configuration file, which SIGHUP reads again. Missing keys change nothing.
struct LogSettings {
  std::optional<LogLevel> level;
  std::optional<LogFormat> format;
};

/// Reads `log: {level: debug|info|warn|error|off, format: text|json}`. Each daemon's configuration reader calls it, so
/// that it knows the key. \throws ConfigError.
LogSettings read_log_settings(YamlSection& top);
/// Reads the section from a file and ignores its other keys. \throws ConfigError.
LogSettings load_log_settings(const std::string& file);

/// Makes this process log so from now on. Thread safe.
void apply(const LogSettings& settings);

/// The options that make a child process log as this one does now: {"--log-level", "info", "--log-format", "json"}.
/// Thread safe.
std::vector<std::string> log_options();

}  // namespace iotcloud::config
