#include <cerrno>
#include <cstring>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <libudev.h>

#include <iotcloud/drivers/property_reader.h>
#include <iotcloud/drivers/usb/usb_finder.h>

namespace iotcloud::drivers::usb {

namespace {

struct UnrefDevice {
  void operator()(udev_device* device) const { udev_device_unref(device); }
};
using OwnedDevice = std::unique_ptr<udev_device, UnrefDevice>;

std::string text_or_none(const char* text) {
  return text == nullptr ? "" : text;
}

void put(PropertyMap& attributes, const char* name, const std::string& value) {
  if (!value.empty()) attributes[name] = value;
}

/// A name for the device that stays when it is plugged in again: /dev/serial/by-id/...
std::string lasting_link(udev_device* device) {
  std::istringstream links(text_or_none(udev_device_get_property_value(device, "DEVLINKS")));
  for (std::string path; links >> path;) {
    if (path.find("/by-id/") != std::string::npos) return path;
  }
  return "";
}

}  // namespace

void UsbFinder::Unref::operator()(udev* library) const {
  udev_unref(library);
}

void UsbFinder::Unref::operator()(udev_monitor* monitor) const {
  udev_monitor_unref(monitor);
}

std::vector<ChannelSpec> UsbFinder::channels(const PropertyMap& properties) {
  PropertyReader reader(properties);
  for (const std::string& word : words_of(reader.text("subsystems", "tty, video4linux, hidraw"))) {
    if (word.find('/') != std::string::npos)
      throw std::invalid_argument("property \"subsystems\" has \"" + word + "\"; it takes names such as tty");
    subsystems_.insert(word);
  }
  return {};
}

void UsbFinder::open(DriverContext& context) {
  context_ = &context;
  udev_.reset(udev_new());
  if (!udev_) throw std::runtime_error("udev cannot be asked: " + std::string(std::strerror(errno)));
  monitor_.reset(udev_monitor_new_from_netlink(udev_.get(), "udev"));
  if (!monitor_) {
    throw std::runtime_error("udev's events cannot be heard: " + std::string(std::strerror(errno)) +
                             "; a driver host with host_ports or host_network has no such sockets");
  }
  for (const auto& subsystem : subsystems_)
    udev_monitor_filter_add_match_subsystem_devtype(monitor_.get(), subsystem.c_str(), nullptr);
  // Before the devices are listed, so that none is missed between.
  if (const int status = udev_monitor_enable_receiving(monitor_.get()); status < 0)
    throw std::runtime_error("udev's events cannot be heard: " + std::string(std::strerror(-status)));
  readable_ = context.on_readable(udev_monitor_get_fd(monitor_.get()), [this] { hear(); });
  list_all();
}

/// Tells all that is there; what was there and is not told again is gone.
void UsbFinder::list_all() {
  context_->report_sight(false);
  context_->report_sight(true);
  for (const auto& subsystem : subsystems_) list(subsystem);
}

void UsbFinder::list(const std::string& subsystem) {
  struct UnrefList {
    void operator()(udev_enumerate* list) const { udev_enumerate_unref(list); }
  };
  const std::unique_ptr<udev_enumerate, UnrefList> found(udev_enumerate_new(udev_.get()));
  udev_enumerate_add_match_subsystem(found.get(), subsystem.c_str());
  udev_enumerate_scan_devices(found.get());
  for (auto* entry = udev_enumerate_get_list_entry(found.get()); entry != nullptr;
       entry = udev_list_entry_get_next(entry)) {
    const OwnedDevice device(udev_device_new_from_syspath(udev_.get(), udev_list_entry_get_name(entry)));
    if (device) look(device.get());
  }
}

void UsbFinder::hear() {
  errno = 0;
  while (const OwnedDevice device{udev_monitor_receive_device(monitor_.get())}) {
    if (text_or_none(udev_device_get_action(device.get())) == "remove") {
      context_->report_gone(text_or_none(udev_device_get_syspath(device.get())));
    } else {
      look(device.get());
    }
    errno = 0;
  }
  if (errno != ENOBUFS) return;
  context_->log(LogLevel::warn, "udev told more at once than the kernel kept: all devices are listed anew");
  list_all();
}

/// Reports the device if it is on USB and programs can open it.
void UsbFinder::look(udev_device* device) {
  const std::string subsystem = text_or_none(udev_device_get_subsystem(device));
  const std::string path = text_or_none(udev_device_get_devnode(device));
  if (!subsystems_.contains(subsystem) || path.empty()) return;
  const bool is_whole = subsystem == "usb" && text_or_none(udev_device_get_devtype(device)) == "usb_device";
  if (subsystem == "usb" && !is_whole) return;
  // The parents are the device's own, and go with it.
  auto* whole = is_whole ? device : udev_device_get_parent_with_subsystem_devtype(device, "usb", "usb_device");
  if (whole == nullptr) return;
  auto* interface = is_whole ? nullptr : udev_device_get_parent_with_subsystem_devtype(device, "usb", "usb_interface");
  const auto attribute = [](udev_device* of, const char* name) {
    return of == nullptr ? "" : text_or_none(udev_device_get_sysattr_value(of, name));
  };
  PropertyMap attributes{{"kind", "usb"}, {"subsystem", subsystem}, {"path", path}};
  put(attributes, "vendor", attribute(whole, "idVendor"));
  put(attributes, "product", attribute(whole, "idProduct"));
  put(attributes, "serial", attribute(whole, "serial"));
  put(attributes, "manufacturer", attribute(whole, "manufacturer"));
  put(attributes, "model", attribute(whole, "product"));
  put(attributes, "interface", attribute(interface, "bInterfaceNumber"));
  put(attributes, "port", text_or_none(udev_device_get_sysname(whole)));
  put(attributes, "link", lasting_link(device));
  context_->report_found(text_or_none(udev_device_get_syspath(device)), attributes);
}

void UsbFinder::close() {
  if (readable_) context_->stop(*std::exchange(readable_, std::nullopt));
  monitor_.reset();
  udev_.reset();
}

}  // namespace iotcloud::drivers::usb
