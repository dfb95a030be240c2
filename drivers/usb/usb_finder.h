#pragma once

#include <array>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>

struct udev;
struct udev_device;
struct udev_monitor;

namespace iotcloud::drivers::usb {

/// Finds devices on USB, by udev: README.md.
class UsbFinder : public Driver {
 public:
  static constexpr std::string_view description = "Finds devices on USB, by udev";
  static constexpr std::array declared_properties{
      PropertySpec{
          .name = "subsystems",
          .default_value = "tty, video4linux, hidraw",
          .text = "of the kernel, whose devices on USB are found: also usb, for whole devices; separated by commas"},
  };

  std::vector<ChannelSpec> channels(const PropertyMap& properties) override;
  void open(DriverContext& context) override;
  void close() override;

 private:
  struct Unref {
    void operator()(udev* library) const;
    void operator()(udev_monitor* monitor) const;
  };
  void list_all();
  void list(const std::string& subsystem);
  void look(udev_device* device);
  void hear();

  DriverContext* context_ = nullptr;
  std::set<std::string> subsystems_;
  std::unique_ptr<udev, Unref> udev_;
  std::unique_ptr<udev_monitor, Unref> monitor_;
  std::optional<HandlerId> readable_;
};

}  // namespace iotcloud::drivers::usb
