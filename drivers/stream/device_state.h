#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::drivers::stream {

/// Logs the first of many like events and each hundredth, with their number.
class RareLog {
 public:
  explicit RareLog(DriverContext& context) : context_(context) {}
  void warn(const std::string& text);
  std::uint64_t count() const { return count_; }

 private:
  DriverContext& context_;
  std::uint64_t count_ = 0;
};

/// How long a driver waits before it looks for its device again: the first time, and at most.
struct ReconnectPauses {
  std::chrono::milliseconds first{500}, most{30'000};
  /// Reads the two properties below. \throws std::invalid_argument when one does not fit, or `most` is below `first`
  static ReconnectPauses read(PropertyReader& reader);
};
inline constexpr PropertySpec reconnect_ms{
    .name = "reconnect_ms",
    .type = PropertyType::integer,
    .unit = "ms",
    .min = 10,
    .max = 600'000,
    .default_value = "500",
    .text = "first pause before it is looked for again; each next one is twice as long"};
inline constexpr PropertySpec reconnect_most_ms{.name = "reconnect_most_ms",
                                                .type = PropertyType::integer,
                                                .unit = "ms",
                                                .min = 10,
                                                .max = 3'600'000,
                                                .default_value = "30000",
                                                .text = "longest such pause"};

/// Tries again after pauses that double, until what is tried has been well for as long as the longest of them.
class Retry {
 public:
  Retry(DriverContext& context, ReconnectPauses pauses);
  ~Retry();
  Retry(const Retry&) = delete;
  Retry& operator=(const Retry&) = delete;

  /// Calls back after the next pause.
  void later(std::function<void()> callback);
  /// It has been reached.
  void reached();
  std::chrono::milliseconds pause() const { return pause_; }  ///< the next one

 private:
  void stop();

  DriverContext& context_;
  const std::chrono::milliseconds first_, most_;
  std::chrono::milliseconds pause_;
  std::optional<HandlerId> timer_;
};

/// Says in the metadata whether a device is there: `connection` is `connected` or `away`, and `connection_problem` says
/// why. Logs when that changes.
class DeviceState {
 public:
  /// Nobody has reached the device yet.
  explicit DeviceState(DriverContext& context);
  /// \param more other metadata.
  void connected(PropertyMap more = {});
  void away(const std::string& reason);
  bool is_there() const { return problem_.empty(); }

 private:
  DriverContext& context_;
  std::string problem_ = "it has not been reached yet";  ///< empty: the device is there
};

}  // namespace iotcloud::drivers::stream
