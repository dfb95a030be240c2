#include <algorithm>
#include <optional>
#include <stdexcept>
#include <vector>

#include <iotcloud/config/number.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/config/yaml/duration.h>
#include <iotcloud/topology/bolt.h>
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

/// Reads a duration into a member of the options.
auto duration_into(std::chrono::milliseconds WindowOptions::*member) {
  return [member](ConfCheck& check, const std::string& key, const std::string& text, WindowOptions& options) {
    if (const auto duration = parse_duration(text)) {
      options.*member = *duration;
    } else {
      refuse(check, key, text, "write a number and a unit: 250ms, 2s, 5m or 1h");
    }
  };
}

auto extent_into(WindowExtent WindowOptions::*member) {
  return [member](ConfCheck& check, const std::string& key, const std::string& text, WindowOptions& options) {
    if (const auto count = config::parse_number<std::int64_t>(text); count && *count > 0) {
      options.*member = WindowExtent(*count);
    } else if (const auto duration = parse_duration(text); duration && duration->count() > 0) {
      options.*member = WindowExtent(*duration);
    } else {
      refuse(check, key, text, "write a number of tuples (100) or a duration (250ms, 2s, 5m, 1h), more than zero");
    }
  };
}

void read_timestamp_field(ConfCheck&, const std::string&, const std::string& text, WindowOptions& options) {
  options.timestamp_field = text;
  options.timestamp = nullptr;
}

const std::vector<ConfOption<WindowOptions>>& declared() {
  static const auto all = [] {
    const WindowOptions usual;
    const auto text = [](std::chrono::milliseconds time) {
      return "the library's, else `" + config::internal::duration_text(time) + "`";
    };
    const std::string extent = "duration, or a number of tuples";
    return std::vector<ConfOption<WindowOptions>>{
        {{"window.length", extent, "the library's", "how much a window holds"}, extent_into(&WindowOptions::length)},
        {{"window.slide", extent, "the library's, else the length", "from one window to the next"},
         extent_into(&WindowOptions::slide)},
        {{"window.timestamp_field", "name of an int field", "the library's, else none: processing time",
          "the tuples' own time, in milliseconds since 1970 UTC"},
         read_timestamp_field},
        {{"window.lag", "duration", text(usual.lag), "event time: how far tuples may be out of order"},
         duration_into(&WindowOptions::lag)},
        {{"window.watermark_interval", "duration", text(usual.watermark_interval),
          "event time: how often the watermark moves; `0s`: with every tuple"},
         duration_into(&WindowOptions::watermark_interval)},
        {{"window.idle_source", "duration", text(usual.idle_source) + ": never",
          "event time: a source that is silent for this long holds it back no longer"},
         duration_into(&WindowOptions::idle_source)}};
  }();
  return all;
}

}  // namespace

std::vector<ConfKey> window_conf_keys() {
  return keys_of(declared());
}

WindowOptions configured(WindowOptions options, const Config& config) {
  ConfCheck check;
  check.read(config, "window.", declared(), options);
  check.finish();
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

std::chrono::microseconds longest_hold(const WindowOptions& options) {
  if (options.length.count > 0 || options.slide.count > 0) return Bolt::until_others_come;
  const auto border = std::max(options.length.duration, options.slide.duration);
  if (border.count() == 0 || !options.event_time()) return border;
  return border + options.lag + options.watermark_interval;
}

}  // namespace iotcloud::topology
