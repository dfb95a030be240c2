#pragma once

#include <array>
#include <chrono>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/stream/stream_driver.h>

namespace iotcloud::drivers::exec {

/// The words of a command line, as a shell takes them apart: blanks separate, quotes and backslashes keep together.
/// There are no variables and no patterns. \throws std::invalid_argument for a quote without its end.
std::vector<std::string> words_of(const std::string& line);

/// A program whose output is a device's, and whose input takes commands: README.md.
class ExecDriver : public stream::ConnectingDriver {
 public:
  static constexpr std::string_view description =
      "A program: what it writes on received, commands to its input on send; it is started again when it ends";
  static constexpr auto declared_properties = stream::joined(
      stream::joined(
          std::array{
              PropertySpec{.name = "command",
                           .required = true,
                           .text = "the program and its arguments; quotes keep words together, no shell reads it"},
              PropertySpec{.name = "folder", .text = "in which it runs; /"},
              PropertySpec{.name = "environment",
                           .text = "variables that it gets besides PATH, HOME, LANG and TZ: A=b 'C=d e'"},
              PropertySpec{.name = "restart",
                           .default_value = "always",
                           .choices = {"always", "on-failure", "never"},
                           .text = "when it is started again after its end"},
              PropertySpec{.name = "grace_ms",
                           .type = PropertyType::integer,
                           .unit = "ms",
                           .min = 0,
                           .max = 8000,
                           .default_value = "2000",
                           .text = "at the instance's end: from SIGTERM to SIGKILL"},
          },
          stream::stream_properties("delimiter")),
      stream::connecting_properties);

  void close() override;

 protected:
  void read(PropertyReader& reader) override;
  void connect() override;
  void ended(const std::string& reason) override;

 private:
  void watch_program();
  void program_ended();
  void finish();
  void read_errors();
  void log_errors(bool last);
  void release();

  std::vector<std::string> command_, environment_;
  std::string folder_, restart_;
  std::chrono::milliseconds grace_{2000};
  int process_ = -1;
  int handle_ = -1;  ///< readable when the process has ended
  int errors_ = -1;  ///< its stderr
  std::string error_line_;
  std::string how_;  ///< it ended; empty: it runs
  std::optional<HandlerId> handle_watch_, errors_watch_;
};

}  // namespace iotcloud::drivers::exec
