#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/property_reader.h>
#include <iotcloud/drivers/stream/address.h>
#include <iotcloud/drivers/stream/device_state.h>

namespace iotcloud::drivers::lan {

/// Gets what was found: a key that is unique for its finder, and attributes.
using OnFound = std::function<void(const std::string& key, const PropertyMap& attributes)>;

/// Asks a group of machines again and again who they are, over UDP, and tells what it finds. What does not answer three
/// times in a row is gone. A finder says what it asks, and what an answer means. Answers are input of strangers.
class LanFinder : public Driver {
 public:
  std::vector<ChannelSpec> channels(const PropertyMap& properties) final;
  void open(DriverContext& context) final;
  void close() final;

 protected:
  /// \param group where questions go, without the property `to`
  explicit LanFinder(std::string group) : group_(std::move(group)) {}
  virtual void read_properties(PropertyReader& reader) { static_cast<void>(reader); }
  /// The datagrams of the next round of questions.
  virtual std::vector<std::string> questions() = 0;
  /// Calls found() for what the answer tells. \return why it is passed over; empty: it is not
  virtual std::string answered(std::string_view answer, const std::string& from) = 0;
  void found(const std::string& key, const PropertyMap& attributes);
  static constexpr std::array shared_properties{
      PropertySpec{.name = "to", .text = "ADDRESS:PORT that is asked; the protocol's group"},
      PropertySpec{.name = "interface", .text = "address of this machine from which it asks; the system chooses"},
      PropertySpec{.name = "period_s",
                   .type = PropertyType::integer,
                   .unit = "s",
                   .min = 1,
                   .max = 86'400,
                   .default_value = "30",
                   .text = "between two rounds of questions; what does not answer three of them is gone"},
  };

 private:
  void ask();
  void next_round();
  void hear();
  void away(const std::string& reason);

  const std::string group_;
  DriverContext* context_ = nullptr;
  std::optional<stream::RareLog> passed_over_;
  std::optional<stream::Address> to_, from_;
  std::chrono::seconds period_{30};
  int socket_ = -1;
  bool sees_ = false;
  std::map<std::string, int> missed_;  ///< by key: rounds without an answer
};

}  // namespace iotcloud::drivers::lan
