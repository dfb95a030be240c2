#pragma once

#include <string_view>

#include <fmt/core.h>

namespace iotcloud::config {

/// How important a line is. `off`: no line is written.
enum class LogLevel { debug, info, warn, error, off };

/// Logs to stderr, one line each: time, level, the part of the system that logs ("brokers.rabbitmq"), the text. Thread
/// safe, never throws. The header hides spdlog, to keep compile times low.
void log_line(LogLevel level, std::string_view part, std::string_view text) noexcept;

/// Sets the lowest level that is written. Default: info. Thread safe.
void set_log_level(LogLevel level);
/// The lowest level that is written. Thread safe.
LogLevel log_level();
/// \param name "debug", "info", "warn", "error" or "off". \throws ConfigError for another name.
LogLevel parse_log_level(std::string_view name);

/// Logs for one part of the system: `const Logger log{"brokers.rabbitmq"}; log.info("connected to {}", url);`
class Logger {
 public:
  constexpr explicit Logger(std::string_view part) : part_(part) {}

  template <typename... Args>
  void debug(fmt::format_string<Args...> format, Args&&... args) const {
    write(LogLevel::debug, format, fmt::make_format_args(args...));
  }
  template <typename... Args>
  void info(fmt::format_string<Args...> format, Args&&... args) const {
    write(LogLevel::info, format, fmt::make_format_args(args...));
  }
  template <typename... Args>
  void warn(fmt::format_string<Args...> format, Args&&... args) const {
    write(LogLevel::warn, format, fmt::make_format_args(args...));
  }
  template <typename... Args>
  void error(fmt::format_string<Args...> format, Args&&... args) const {
    write(LogLevel::error, format, fmt::make_format_args(args...));
  }

 private:
  void write(LogLevel level, fmt::string_view format, fmt::format_args args) const noexcept;
  std::string_view part_;
};

}  // namespace iotcloud::config
