#pragma once

#include <array>
#include <string>
#include <string_view>

#include <iotcloud/drivers/stream/stream_driver.h>

namespace iotcloud::drivers::serial {

/// A device on a serial line: README.md.
class SerialDriver : public stream::ConnectingDriver {
 public:
  static constexpr std::string_view description =
      "A device on a serial line: its frames on received, commands to it on send";
  static constexpr auto declared_properties = stream::joined(
      stream::joined(
          std::array{
              PropertySpec{.name = "device", .required = true, .text = "such as /dev/ttyUSB0"},
              PropertySpec{.name = "baud",
                           .default_value = "115200",
                           .choices = {"1200", "2400", "4800", "9600", "19200", "38400", "57600", "115200", "230400",
                                       "460800", "921600", "1000000", "2000000", "3000000"},
                           .text = "bits a second"},
              PropertySpec{.name = "data_bits", .default_value = "8", .choices = {"7", "8"}},
              PropertySpec{.name = "parity", .default_value = "none", .choices = {"none", "even", "odd"}},
              PropertySpec{.name = "stop_bits", .default_value = "1", .choices = {"1", "2"}},
              PropertySpec{.name = "flow_control",
                           .default_value = "none",
                           .choices = {"none", "hardware", "software"},
                           .text = "hardware: RTS and CTS; software: XON and XOFF, for frames of text"},
          },
          stream::stream_properties("delimiter")),
      stream::connecting_properties);

 protected:
  void read(PropertyReader& reader) override;
  void connect() override;

 private:
  /// Sets the line. \return why it cannot; empty: it is set
  std::string set_line(int descriptor) const;

  std::string device_, baud_, data_bits_, parity_, stop_bits_, flow_control_;
};

}  // namespace iotcloud::drivers::serial
