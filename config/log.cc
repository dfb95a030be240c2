#include <algorithm>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <dlfcn.h>
#include <nlohmann/json.hpp>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::config {

namespace {

constexpr const char* text_pattern = "%Y-%m-%dT%H:%M:%S.%e %^%-5l%$ %v";
constexpr const char* json_pattern = R"({"time":"%Y-%m-%dT%H:%M:%S.%e%z","level":"%l",%v})";

std::atomic<LogFormat> line_format{LogFormat::text};
std::atomic<LogTarget> line_target{nullptr};

/// Writes text as a JSON string, quotes included. Replaces bytes that are not UTF-8.
std::string quoted(std::string_view text) {
  return nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

spdlog::level::level_enum to_spdlog(LogLevel level) {
  switch (level) {
    case LogLevel::debug:
      return spdlog::level::debug;
    case LogLevel::info:
      return spdlog::level::info;
    case LogLevel::warn:
      return spdlog::level::warn;
    case LogLevel::error:
      return spdlog::level::err;
    case LogLevel::off:
      break;
  }
  return spdlog::level::off;
}

spdlog::logger& sink() {
  // Never destroyed: threads may still log while the process ends.
  static spdlog::logger& logger = *[] {
    auto made = new spdlog::logger("iotcloud", std::make_shared<spdlog::sinks::stderr_sink_mt>());
    made->set_pattern(text_pattern);
    made->set_level(spdlog::level::info);
    made->flush_on(spdlog::level::debug);
    return made;
  }();
  return logger;
}

/// The function iotcloud_follow_log() of a library.
using Follow = void (*)(LogLevel, LogFormat, LogTarget) noexcept;

/// The libraries that log as this process.
class Followers {
 public:
  void add(Follow follow) {
    const MutexLock lock(mutex_);
    if (std::find(all_.begin(), all_.end(), follow) == all_.end()) all_.push_back(follow);
    follow(log_level(), log_format(), line_target);
  }
  void tell() {
    const MutexLock lock(mutex_);
    for (const Follow follow : all_) follow(log_level(), log_format(), line_target);
  }

 private:
  Mutex mutex_;
  std::vector<Follow> all_ IOTCLOUD_GUARDED_BY(mutex_);
};

Followers& followers() {
  static Followers& libraries = *new Followers;
  return libraries;
}

}  // namespace

/// The process that opened this library finds it by its name.
extern "C" __attribute__((visibility("default"))) void iotcloud_follow_log(LogLevel level, LogFormat format,
                                                                           LogTarget target) noexcept {
  try {
    set_log_level(level);
    set_log_format(format);
    set_log_target(target);
  } catch (...) {  // it logs as before
  }
}

void share_log(void* library) {
  if (const auto follow = reinterpret_cast<Follow>(dlsym(library, "iotcloud_follow_log"))) followers().add(follow);
}

void log_line(LogLevel level, std::string_view part, std::string_view text) noexcept {
  try {
    if (const LogTarget target = line_target) {
      if (sink().should_log(to_spdlog(level))) target(level, part, text);
    } else if (line_format == LogFormat::json) {
      sink().log(to_spdlog(level), R"("part":{},"text":{})", quoted(part), quoted(text));
    } else {
      sink().log(to_spdlog(level), "{}: {}", part, text);
    }
  } catch (...) {  // a line that cannot be written must not stop the caller
  }
}

void set_log_target(LogTarget target) {
  line_target = target;
  followers().tell();
}

void set_log_level(LogLevel level) {
  sink().set_level(to_spdlog(level));
  followers().tell();
}

void set_log_format(LogFormat format) {
  sink().set_pattern(format == LogFormat::json ? json_pattern : text_pattern);
  line_format = format;
  followers().tell();
}

LogFormat log_format() {
  return line_format;
}

LogLevel log_level() {
  switch (sink().level()) {
    case spdlog::level::trace:
    case spdlog::level::debug:
      return LogLevel::debug;
    case spdlog::level::info:
      return LogLevel::info;
    case spdlog::level::warn:
      return LogLevel::warn;
    case spdlog::level::err:
    case spdlog::level::critical:
      return LogLevel::error;
    default:
      return LogLevel::off;
  }
}

LogLevel parse_log_level(std::string_view name) {
  if (name == "debug") return LogLevel::debug;
  if (name == "info") return LogLevel::info;
  if (name == "warn") return LogLevel::warn;
  if (name == "error") return LogLevel::error;
  if (name == "off") return LogLevel::off;
  throw ConfigError({}, "log level", "\"" + std::string(name) + "\" is none", "use debug, info, warn, error or off");
}

void Logger::write(LogLevel level, fmt::string_view format, fmt::format_args args) const noexcept {
  try {
    if (!sink().should_log(to_spdlog(level))) return;
    log_line(level, part_, fmt::vformat(format, args));
  } catch (...) {  // as in log_line
  }
}

}  // namespace iotcloud::config
