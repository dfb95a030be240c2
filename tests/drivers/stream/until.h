#pragma once

#include <chrono>
#include <functional>

#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::drivers {

/// Runs the instance's descriptors and what it posts, in real time, until the condition holds. Simulated time stands
/// still. \return false: it does not hold, or the instance has failed
[[nodiscard]] inline bool until(testing::MockInstance& instance, const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + tests::patience;
  while (!condition()) {
    if (instance.host().failed() || std::chrono::steady_clock::now() > end) return false;
    instance.host().poll_descriptors(std::chrono::milliseconds(2));
    instance.host().run_posted();
  }
  return true;
}

/// The same until so many messages were published on the channel.
[[nodiscard]] inline bool until_published(testing::MockInstance& instance, const std::string& channel,
                                          std::size_t count) {
  return until(instance, [&] { return instance.host().published(channel).size() >= count; });
}

/// The same until the metadata have this value.
[[nodiscard]] inline bool until_metadata(testing::MockInstance& instance, const std::string& key,
                                         const std::string& value) {
  return until(instance, [&] {
    const PropertyMap all = instance.host().metadata();
    const auto found = all.find(key);
    return (found == all.end() ? "" : found->second) == value;
  });
}

/// The texts of the messages on a channel.
inline std::vector<std::string> texts(testing::MockInstance& instance, const std::string& channel) {
  std::vector<std::string> all;
  for (const auto& published : instance.host().published(channel)) all.emplace_back(published.message.payload.text());
  return all;
}

/// A command with this text.
inline Message command(const std::string& text) {
  Message message;
  message.payload = Payload::copy(text);
  return message;
}

}  // namespace iotcloud::drivers
