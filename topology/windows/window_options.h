#pragma once

#include <chrono>
#include <concepts>
#include <cstdint>
#include <functional>
#include <string>

#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/topology_context.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology {

/// How much: a number of tuples (`10`), or a time (`2s`). Zero of both: not said.
struct WindowExtent {
  WindowExtent() = default;
  template <std::integral Number>
  WindowExtent(Number tuples) : count(static_cast<std::int64_t>(tuples)) {}  // NOLINT(google-explicit-constructor)
  WindowExtent(std::chrono::milliseconds time) : duration(time) {}           // NOLINT(google-explicit-constructor)

  bool said() const { return count != 0 || duration.count() != 0; }
  bool counts() const { return count != 0; }

  std::int64_t count = 0;
  std::chrono::milliseconds duration{0};
};

/// Which tuples make a window, and when it is evaluated. `WindowOptions{.length = 10s, .slide = 2s}`.
///
/// A window of a duration holds [end - length, end); its ends are the multiples of the slide, in processing time since
/// the task was prepared, in event time since 1970. A window of a count holds the newest `length` tuples. Length and
/// slide may be mixed. Windows without tuples are not evaluated.
struct WindowOptions {
  WindowExtent length;
  WindowExtent slide{};  ///< how far from one window to the next; not said: `length` (tumbling windows)

  // Event time. Neither of the two: processing time, that is when the task gets the tuple.
  std::string timestamp_field{};                          ///< of the tuples: int, milliseconds since 1970 UTC
  std::function<std::int64_t(const Tuple&)> timestamp{};  ///< instead of a field; in milliseconds
  std::chrono::milliseconds lag{0};                       ///< how far tuples may be out of order
  std::chrono::milliseconds watermark_interval{1000};     ///< how often time moves on; 0: with every tuple
  /// A source task that is silent for so long does not hold event time back any more. 0: it does for ever.
  std::chrono::milliseconds idle_source{0};
  /// A tuple that comes after its time (before the watermark) is emitted there, anchored, with those of its fields that
  /// `late_fields` names (null where it has none of that name). No stream: dropped. Counted and acked in any case.
  std::string late_stream{};
  Fields late_fields{};

  bool event_time() const { return !timestamp_field.empty() || timestamp; }
};

/// What the component's configuration says in place of the options: `window.length` and `window.slide` ("100" tuples or
/// "10s"), `window.timestamp_field`, `window.lag`, `window.watermark_interval`, `window.idle_source`.
/// \throws std::invalid_argument when a value cannot be read, or the result makes no windows.
WindowOptions configured(WindowOptions options, const Config& config);

}  // namespace iotcloud::topology
