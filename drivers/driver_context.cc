#include <charconv>
#include <stdexcept>
#include <utility>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers {

namespace {

template <typename Number>
Number parse_number(const PropertyMap& properties, const std::string& name, Number fallback, const char* kind) {
  const auto found = properties.find(name);
  if (found == properties.end()) return fallback;
  const std::string& text = found->second;
  Number value{};
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (status != std::errc{} || end != text.data() + text.size()) {
    throw std::invalid_argument("property \"" + name + "\" is \"" + text + "\", which is not " + kind);
  }
  return value;
}

}  // namespace

std::string DriverContext::property(const std::string& name, const std::string& fallback) const {
  const auto found = properties().find(name);
  return found == properties().end() ? fallback : found->second;
}

double DriverContext::number(const std::string& name, double fallback) const {
  return parse_number(properties(), name, fallback, "a number");
}

std::int64_t DriverContext::integer(const std::string& name, std::int64_t fallback) const {
  return parse_number(properties(), name, fallback, "a whole number");
}

std::string DriverContext::property(const std::string& name) const {
  const auto found = properties().find(name);
  if (found != properties().end()) return found->second;
  throw std::invalid_argument("property \"" + name + "\" is missing, and the driver declares no default for it");
}

double DriverContext::number(const std::string& name) const {
  static_cast<void>(property(name));  // throws when it is missing
  return number(name, 0);
}

std::int64_t DriverContext::integer(const std::string& name) const {
  static_cast<void>(property(name));  // throws when it is missing
  return integer(name, 0);
}

std::function<void()> DriverContext::guarded(std::function<void()> callback) {
  return [this, callback = std::move(callback)] {
    try {
      callback();
    } catch (const std::exception& e) {
      fail(e.what());
    } catch (...) {
      fail("a callback threw an exception that is not a std::exception");
    }
  };
}

HandlerId DriverContext::every(std::chrono::microseconds period, std::function<void()> callback) {
  return host_.start_timer(period, period, guarded(std::move(callback)));
}

HandlerId DriverContext::after(std::chrono::microseconds delay, std::function<void()> callback) {
  return host_.start_timer(delay, std::chrono::microseconds{0}, guarded(std::move(callback)));
}

HandlerId DriverContext::on_readable(int descriptor, std::function<void()> callback) {
  return host_.watch_descriptor(descriptor, false, guarded(std::move(callback)));
}

HandlerId DriverContext::on_writable(int descriptor, std::function<void()> callback) {
  return host_.watch_descriptor(descriptor, true, guarded(std::move(callback)));
}

void DriverContext::post(std::function<void()> callback) {
  host_.post(guarded(std::move(callback)));
}

}  // namespace iotcloud::drivers
