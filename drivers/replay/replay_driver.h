#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/recording/player.h>

namespace iotcloud::drivers::replay {

/// Plays one instance of a recording: its outgoing channels send what they sent, in the same order and at the same
/// pace, or another. Messages that come on its incoming channels are taken and counted. README.md has the properties.
class ReplayDriver : public Driver {
 public:
  static constexpr std::string_view description = "Plays what an instance sent, from a recording of iotcloud record";
  static constexpr std::array declared_properties{
      PropertySpec{.name = "file", .required = true, .text = "the recording, on the gateway's machine"},
      PropertySpec{.name = "instance",
                   .text = "which of the recorded instances: its id, the id's beginning, or its name (meter/2); needed "
                           "if there are several"},
      PropertySpec{.name = "speed",
                   .type = PropertyType::number,
                   .min = 0,
                   .max = 1e6,
                   .default_value = "1",
                   .text = "2 plays twice as fast; 0 as fast as the channels take it"},
      PropertySpec{
          .name = "loop", .type = PropertyType::flag, .default_value = "false", .text = "begin again at the end"},
      PropertySpec{.name = "times",
                   .default_value = "recorded",
                   .choices = {"recorded", "now"},
                   .text = "the time of each message: the recorded one, or the present"},
  };

  using Clock = std::function<std::chrono::steady_clock::time_point()>;
  explicit ReplayDriver(Clock clock = std::chrono::steady_clock::now) : clock_(std::move(clock)) {}

  /// \throws std::invalid_argument, RecordingError for a file that is no recording, or has no such instance.
  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void activate() override;
  void deactivate() override;
  void close() override;
  void on_message(std::string_view channel, Message message) override;
  void on_writable(std::string_view channel) override;

 private:
  void find_instance(const std::string& word);
  bool plays(std::size_t channel) const;
  enum class Fetched { message, later, none };
  /// Reads on until a message of this instance is next. \return later: others of the host have their turn first; none:
  /// there is no more, and the play has ended
  Fetched fetch();
  void send_due();
  void end();

  const Clock clock_;
  DriverContext* context_ = nullptr;
  std::unique_ptr<recording::RecordingReader> recording_;
  std::string instance_;  ///< the one that is played
  std::string driver_;
  double speed_ = 1;
  bool loop_ = false, now_ = false;
  bool active_ = false, blocked_ = false, ended_ = false;
  std::optional<recording::RecordedMessage> next_;
  std::optional<recording::Pace> pace_;  ///< since the last activation, or the beginning of a round
  std::optional<HandlerId> timer_;
  std::uint64_t sent_ = 0, of_round_ = 0, received_ = 0;
};

}  // namespace iotcloud::drivers::replay
