#include <cerrno>
#include <cstring>
#include <map>

#include <fcntl.h>
#include <sys/file.h>
#include <termios.h>
#include <unistd.h>

#include <iotcloud/drivers/serial/serial_driver.h>

namespace iotcloud::drivers::serial {

namespace {

const std::map<std::string, speed_t>& speeds() {
  static const std::map<std::string, speed_t> all{
      {"1200", B1200},     {"2400", B2400},       {"4800", B4800},       {"9600", B9600},      {"19200", B19200},
      {"38400", B38400},   {"57600", B57600},     {"115200", B115200},   {"230400", B230400},  {"460800", B460800},
      {"921600", B921600}, {"1000000", B1000000}, {"2000000", B2000000}, {"3000000", B3000000}};
  return all;
}

}  // namespace

void SerialDriver::read(PropertyReader& reader) {
  ConnectingDriver::read(reader);
  device_ = reader.text("device", "");
  baud_ = reader.text("baud", "115200");
  data_bits_ = reader.text("data_bits", "8");
  parity_ = reader.text("parity", "none");
  stop_bits_ = reader.text("stop_bits", "1");
  flow_control_ = reader.text("flow_control", "none");
}

void SerialDriver::connect() {
  const int line = ::open(device_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
  if (line < 0) return away(device_ + " cannot be opened: " + std::strerror(errno));
  if (const std::string problem = set_line(line); !problem.empty()) {
    ::close(line);
    return away(device_ + problem);
  }
  connected(line, line, {{"device", device_}});
}

std::string SerialDriver::set_line(int descriptor) const {
  termios line{};
  if (tcgetattr(descriptor, &line) != 0) return std::string(" is no serial line: ") + std::strerror(errno);
  if (flock(descriptor, LOCK_EX | LOCK_NB) != 0) return " is in use by another program";
  cfmakeraw(&line);
  const speed_t speed = speeds().at(baud_);
  cfsetispeed(&line, speed);
  cfsetospeed(&line, speed);
  line.c_cflag &= ~static_cast<tcflag_t>(CSIZE | PARENB | PARODD | CSTOPB | CRTSCTS);
  line.c_cflag |= CLOCAL | CREAD | (data_bits_ == "7" ? CS7 : CS8);
  if (parity_ != "none") line.c_cflag |= PARENB;
  if (parity_ == "odd") line.c_cflag |= PARODD;
  if (stop_bits_ == "2") line.c_cflag |= CSTOPB;
  if (flow_control_ == "hardware") line.c_cflag |= CRTSCTS;
  if (parity_ != "none") line.c_iflag |= INPCK;
  if (flow_control_ == "software") line.c_iflag |= IXON | IXOFF;
  line.c_cc[VMIN] = 1;
  line.c_cc[VTIME] = 0;
  if (tcsetattr(descriptor, TCSANOW, &line) != 0)
    return std::string(" does not take these settings: ") + std::strerror(errno);
  // It says that it has set a line of which it has set a part.
  termios set{};
  if (tcgetattr(descriptor, &set) != 0 || cfgetospeed(&set) != speed) return " does not take a baud of " + baud_;
  tcflush(descriptor, TCIOFLUSH);  // what came before belongs to nobody
  return "";
}

}  // namespace iotcloud::drivers::serial
