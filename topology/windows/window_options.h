#pragma once

#include <chrono>
#include <concepts>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <iotcloud/topology/conf_keys.h>
#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/topology_context.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology {

/// A number of tuples (`10`) or a time (`2s`). Both zero: not set.
struct WindowExtent {
  WindowExtent() = default;
  template <std::integral Number>
  WindowExtent(Number tuples) : count(static_cast<std::int64_t>(tuples)) {}  // NOLINT(google-explicit-constructor)
  /// Any duration of whole milliseconds, such as `10s`.
  template <std::convertible_to<std::chrono::milliseconds> Time>
  WindowExtent(Time time) : duration(time) {}  // NOLINT(google-explicit-constructor)

  bool said() const { return count != 0 || duration.count() != 0; }
  bool counts() const { return count != 0; }

  std::int64_t count = 0;
  std::chrono::milliseconds duration{0};
};

/// Defines windows and when they are evaluated. `WindowOptions{.length = 10s, .slide = 2s}`.
///
/// A window with a duration holds [end - length, end). Its ends are the multiples of the slide, counted in processing
/// time from the task's prepare(), in event time from 1970. A window with a count holds the newest `length` tuples.
/// Length and slide may be mixed. Windows without tuples are not evaluated.
struct WindowOptions {
  WindowExtent length;
  WindowExtent slide{};  ///< distance between windows; not set: `length` (tumbling windows)

  // Event time. Without a field and a function, windows use processing time: when the task gets the tuple.
  std::string timestamp_field{};  ///< the tuples' field with the time stamp: int, milliseconds since 1970 UTC
  std::function<std::int64_t(const Tuple&)> timestamp{};  ///< replaces the field; returns milliseconds
  std::chrono::milliseconds lag{0};                       ///< how far tuples may be out of order
  std::chrono::milliseconds watermark_interval{1000};     ///< how often the watermark moves; 0: with every tuple
  /// A source task that was silent for this long no longer holds event time back. 0: it always does.
  std::chrono::milliseconds idle_source{0};
  /// A late tuple (behind the watermark) is emitted to this stream, anchored, with its fields that `late_fields` names
  /// (null for missing ones). Empty: it is dropped. Late tuples are always counted and acked.
  std::string late_stream{};
  Fields late_fields{};

  bool event_time() const { return !timestamp_field.empty() || timestamp; }
};

/// The keys of `conf` that override the options, all of which begin with `window.`.
std::vector<ConfKey> window_conf_keys();

/// Overrides options by the component's configuration, see window_conf_keys().
/// \throws std::invalid_argument if there is another key that begins with `window.`, a value cannot be read, or the
/// result makes no windows.
WindowOptions configured(WindowOptions options, const Config& config);

/// For how long a window may keep a tuple: until the end of the last window that may contain it. Where length or slide
/// is a number of tuples, that is Bolt::until_others_come.
std::chrono::microseconds longest_hold(const WindowOptions& options);

}  // namespace iotcloud::topology
