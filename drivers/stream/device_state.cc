#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>

#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::stream {

void RareLog::warn(const std::string& text) {
  constexpr std::uint64_t each = 100;
  if (++count_ != 1 && count_ % each != 0) return;
  context_.log(LogLevel::warn, text + " (" + std::to_string(count_) + " so far; not all are logged)");
}

ReconnectPauses ReconnectPauses::read(PropertyReader& reader) {
  const auto milliseconds = [&](const PropertySpec& spec, std::chrono::milliseconds usual) {
    return std::chrono::milliseconds(reader.integer(std::string(spec.name), static_cast<int>(usual.count()),
                                                    static_cast<int>(*spec.min), static_cast<int>(*spec.max)));
  };
  ReconnectPauses pauses;
  pauses.first = milliseconds(reconnect_ms, pauses.first);
  pauses.most = milliseconds(reconnect_most_ms, pauses.most);
  if (pauses.most < pauses.first) {
    throw std::invalid_argument("property \"reconnect_most_ms\" is " + std::to_string(pauses.most.count()) +
                                "; it takes at least reconnect_ms, " + std::to_string(pauses.first.count()));
  }
  return pauses;
}

Retry::Retry(DriverContext& context, ReconnectPauses pauses)
    : context_(context), first_(pauses.first), most_(pauses.most), pause_(pauses.first) {}

Retry::~Retry() {
  stop();
}

void Retry::stop() {
  if (timer_) context_.stop(*std::exchange(timer_, std::nullopt));
}

void Retry::later(std::function<void()> callback) {
  stop();
  timer_ = context_.after(pause_, [this, callback = std::move(callback)] {
    const auto call = callback;  // a copy: later() replaces it
    timer_.reset();
    call();
  });
  pause_ = std::min(2 * pause_, most_);
}

void Retry::reached() {
  stop();
  timer_ = context_.after(most_, [this] {
    timer_.reset();
    pause_ = first_;
  });
}

DeviceState::DeviceState(DriverContext& context) : context_(context) {
  context_.update_metadata({{"connection", "away"}, {"connection_problem", problem_}});
}

void DeviceState::connected(PropertyMap more) {
  more["connection"] = "connected";
  more["connection_problem"] = "";
  context_.update_metadata(more);
  if (!problem_.empty()) context_.log(LogLevel::info, "the device is there");
  problem_.clear();
}

void DeviceState::away(const std::string& reason) {
  context_.update_metadata({{"connection", "away"}, {"connection_problem", reason}});
  if (problem_ != reason) context_.log(LogLevel::warn, "the device is away: " + reason);
  problem_ = reason;
}

}  // namespace iotcloud::drivers::stream
