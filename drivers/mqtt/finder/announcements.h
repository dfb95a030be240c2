#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers::mqtt {

/// What a kind of announcement tells of what was found; keys are unique over all kinds.
struct Findings {
  std::function<void(const std::string& key, const PropertyMap& attributes)> found;
  std::function<void(const std::string& key)> gone;
  std::function<void(const std::string& text)> warn;  ///< something was passed over, and why
};

/// JSON objects that devices announce on topics of their own: their texts, numbers and flags are attributes. An empty
/// message says that the device is gone. What is announced is input of strangers.
class PlainAnnouncements {
 public:
  explicit PlainAnnouncements(Findings findings) : findings_(std::move(findings)) {}
  void take(const std::string& topic, std::string_view payload);

 private:
  const Findings findings_;
};

/// Home Assistant's MQTT discovery: entities at PREFIX/COMPONENT/[NODE/]OBJECT/config, of which those of one device are
/// one thing, and whole devices at PREFIX/device/OBJECT/config. Abbreviated keys and the base topic `~` are understood;
/// templates (Jinja) are not evaluated. What is announced is input of strangers.
class HomeAssistant {
 public:
  static constexpr std::size_t most_entities = 50'000;  ///< of all devices
  static constexpr std::size_t most_entities_of_device = 200;

  /// \param most_bytes of what is kept of all devices, about
  HomeAssistant(std::string prefix, Findings findings, std::size_t most_bytes = std::size_t{64} << 20)
      : prefix_(std::move(prefix)), findings_(std::move(findings)), most_bytes_(most_bytes) {}
  /// The filter of its topics.
  std::string filter() const { return prefix_ + "/#"; }
  /// Whether this is a topic of an announcement.
  bool is_announcement(std::string_view topic) const;
  void take(const std::string& topic, std::string_view payload);
  /// Forgets everything: it is announced again.
  void clear();

 private:
  struct Topic {
    std::string topic, name;
    bool command = false;
  };
  struct Entity {
    std::string device;  ///< its key
    std::string component;
    PropertyMap attributes;  ///< of its device, as it says
    std::vector<Topic> topics;
    std::string availability, available, not_available;
    std::size_t bytes() const;
  };
  struct Device {
    std::set<std::string> announced;  ///< topics of its announcements
  };
  std::optional<std::vector<Entity>> read(const std::string& topic, std::string_view payload) const;
  void report(const std::string& device);
  void forget(const std::string& topic, std::set<std::string>& changed);

  std::string prefix_;
  const Findings findings_;
  const std::size_t most_bytes_;
  std::map<std::string, std::vector<Entity>> announced_;  ///< by topic
  std::map<std::string, Device> devices_;                 ///< by key
  std::size_t entities_ = 0, bytes_ = 0;
};

}  // namespace iotcloud::drivers::mqtt
