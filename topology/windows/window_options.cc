#include <algorithm>
#include <optional>
#include <stdexcept>

#include <iotcloud/config/number.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/topology/conf_keys.h>
#include <iotcloud/topology/windows/window_options.h>

namespace iotcloud::topology {

namespace {

void refuse(ConfCheck& check, const std::string& key, const std::string& text, const std::string& remedy) {
  check.refuse(key, "\"" + text + "\" cannot be read; " + remedy);
}

std::optional<std::chrono::milliseconds> parse_duration(const std::string& text) {
  const auto duration = config::parse_duration(text);
  if (!duration) return std::nullopt;
  return std::chrono::duration_cast<std::chrono::milliseconds>(*duration);
}

void read_duration(ConfCheck& check, const Config& config, const std::string& key, std::chrono::milliseconds& value) {
  const auto found = config.find(key);
  if (found == config.end()) return;
  const auto duration = parse_duration(found->second);
  if (duration) {
    value = *duration;
  } else {
    refuse(check, key, found->second, "write a number and a unit: 250ms, 2s, 5m or 1h");
  }
}

void read_extent(ConfCheck& check, const Config& config, const std::string& key, WindowExtent& value) {
  const auto found = config.find(key);
  if (found == config.end()) return;
  const std::string& text = found->second;
  if (const auto count = config::parse_number<std::int64_t>(text); count && *count > 0) {
    value = WindowExtent(*count);
  } else if (const auto duration = parse_duration(text); duration && duration->count() > 0) {
    value = WindowExtent(*duration);
  } else {
    refuse(check, key, text, "write a number of tuples (100) or a duration (250ms, 2s, 5m, 1h), more than zero");
  }
}

}  // namespace

WindowOptions configured(WindowOptions options, const Config& config) {
  ConfCheck check;
  check.refuse_unknown_keys(config, "window.",
                            {"window.length", "window.slide", "window.lag", "window.watermark_interval",
                             "window.idle_source", "window.timestamp_field"});
  read_extent(check, config, "window.length", options.length);
  read_extent(check, config, "window.slide", options.slide);
  read_duration(check, config, "window.lag", options.lag);
  read_duration(check, config, "window.watermark_interval", options.watermark_interval);
  read_duration(check, config, "window.idle_source", options.idle_source);
  check.finish();
  if (const auto field = config.find("window.timestamp_field"); field != config.end()) {
    options.timestamp_field = field->second;
    options.timestamp = nullptr;
  }
  if (!options.length.said()) {
    throw std::invalid_argument(
        "a windowed bolt needs the length of its windows (WindowOptions::length, or conf "
        "window.length): a number of tuples or a duration");
  }
  if (!options.slide.said()) options.slide = options.length;
  for (const WindowExtent& extent : {options.length, options.slide}) {
    if (extent.count < 0 || extent.duration.count() < 0) {
      throw std::invalid_argument("length and slide of a window must be more than zero");
    }
  }
  if (!options.timestamp_field.empty() && options.timestamp) {
    throw std::invalid_argument("name either the timestamp's field (\"" + options.timestamp_field +
                                "\") or a function that finds it, not both");
  }
  if (!options.event_time() && (options.lag.count() != 0 || !options.late_stream.empty())) {
    throw std::invalid_argument(
        "lag and late stream are of event time; name the field of the timestamp "
        "(WindowOptions::timestamp_field, or conf window.timestamp_field)");
  }
  return options;
}

std::chrono::milliseconds longest_hold(const WindowOptions& options) {
  const auto border = std::max(options.length.duration, options.slide.duration);
  if (border.count() == 0 || !options.event_time()) return border;
  return border + options.lag + options.watermark_interval;
}

}  // namespace iotcloud::topology
