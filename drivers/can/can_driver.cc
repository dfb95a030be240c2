#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <stdexcept>
#include <utility>

#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/can/can_driver.h>
#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::drivers::can {

namespace {

constexpr int reads_at_once = 64;  // then other handlers of the event thread have their turn

struct Id {
  std::uint32_t number = 0;
  bool extended = false;
};

/// nullopt: it is none.
std::optional<Id> read_id(std::string_view text) {
  constexpr std::size_t standard_digits = 3;
  Id id;
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), id.number, 16);
  id.extended = text.size() > standard_digits;
  if (status != std::errc{} || end != text.data() + text.size() ||
      id.number > (id.extended ? CAN_EFF_MASK : CAN_SFF_MASK))
    return std::nullopt;
  return id;
}

std::string text_of(const Id& id) {
  std::array<char, 16> text{};
  std::snprintf(text.data(), text.size(), id.extended ? "%08x" : "%03x", id.number);
  return text.data();
}

bool is_true(const Message& message, std::string_view property) {
  const std::string* value = message.properties.find(property);
  return value && *value == "true";
}

}  // namespace

std::vector<Filter> read_filters(const std::string& text) {
  std::vector<Filter> filters;
  for (const std::string& word : words_of(text)) {
    const auto colon = word.find(':');
    const auto id = read_id(word.substr(0, colon));
    if (!id)
      throw std::invalid_argument("property \"filters\" has \"" + word +
                                  "\"; it takes ID or ID:MASK in hexadecimal, such as 123 or 18fef100:1fffff00");
    Filter filter{id->number, id->extended ? CAN_EFF_MASK : CAN_SFF_MASK, id->extended};
    if (colon != std::string::npos) {
      const char *first = word.data() + colon + 1, *last = word.data() + word.size();
      const auto [stop, status] = std::from_chars(first, last, filter.mask, 16);
      if (status != std::errc{} || stop != last || filter.mask > CAN_EFF_MASK)
        throw std::invalid_argument("property \"filters\" has \"" + word +
                                    "\", whose mask is no hexadecimal number of 29 bits");
    }
    filters.push_back(filter);
  }
  return filters;
}

int CanDriver::open_socket(const Socket& wanted) {
  const int socket = ::socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
  if (socket < 0)
    throw std::runtime_error(std::string("the kernel has no SocketCAN, or does not let the host use it: ") +
                             std::strerror(errno));
  const auto check = [&](int status, const std::string& what) {
    if (status == 0) return;
    const std::string why = std::strerror(errno);
    ::close(socket);
    throw std::runtime_error(what + ": " + why);
  };
  std::vector<can_filter> filters;
  for (const Filter& filter : wanted.filters) {
    const std::uint32_t kind = filter.extended ? CAN_EFF_FLAG : 0;
    filters.push_back({filter.id | kind, filter.mask | CAN_EFF_FLAG});
  }
  if (!filters.empty()) {
    check(setsockopt(socket, SOL_CAN_RAW, CAN_RAW_FILTER, filters.data(),
                     static_cast<socklen_t>(filters.size() * sizeof(can_filter))),
          "the filters");
  }
  const int on = 1;
  if (wanted.fd) check(setsockopt(socket, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on), "CAN FD");
  const can_err_mask_t errors = CAN_ERR_MASK;
  check(setsockopt(socket, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors), "error frames");
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = static_cast<int>(if_nametoindex(wanted.interface.c_str()));
  check(address.can_ifindex == 0 ? -1 : 0, wanted.interface);
  check(bind(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address), wanted.interface);
  return socket;
}

std::vector<ChannelSpec> CanDriver::channels(const PropertyMap& properties) {
  PropertyReader reader(properties);
  wanted_ = {reader.text("interface", ""), read_filters(reader.text("filters", "")), reader.flag("fd", false)};
  send_id_ = reader.text("send_id", "");
  if (!send_id_.empty() && !read_id(send_id_))
    throw std::invalid_argument("property \"send_id\" is \"" + send_id_ +
                                "\"; it takes an id in hexadecimal, such as 123 or 18fef100");
  ChannelSpec received;
  received.name = received_channel;
  received.broker = reader.text("broker", "");
  ChannelSpec commands = received;
  commands.name = send_channel;
  commands.direction = Direction::in;
  return {received, commands};
}

void CanDriver::open(DriverContext& context) {
  context_ = &context;
  lost_.emplace(context);
  errors_.emplace(context);
  retry_.emplace(context, stream::ReconnectPauses{});
  state_.emplace(context);
  connect();
}

void CanDriver::connect() {
  try {
    socket_ = opener_(wanted_);
  } catch (const std::runtime_error& e) {
    return away(e.what());
  }
  retry_->reached();
  state_->connected({{"interface", wanted_.interface}});
  if (!unpublished_) watch();
}

void CanDriver::away(const std::string& reason) {
  if (readable_) context_->stop(*std::exchange(readable_, std::nullopt));
  if (socket_ >= 0) ::close(std::exchange(socket_, -1));
  state_->away(reason);
  retry_->later([this] { connect(); });
}

void CanDriver::close() {
  retry_.reset();
  if (socket_ >= 0) ::close(std::exchange(socket_, -1));
}

void CanDriver::watch() {
  readable_ = context_->on_readable(socket_, [this] { read(); });
}

void CanDriver::read() {
  for (int i = 0; i < reads_at_once; ++i) {
    canfd_frame frame{};
    const ssize_t size = ::read(socket_, &frame, sizeof frame);
    if (size < 0 && (errno == EAGAIN || errno == EINTR)) return;
    if (size <= 0) return away(size == 0 ? "it was closed" : std::strerror(errno));
    const bool fd = size == CANFD_MTU;
    if ((!fd && size != CAN_MTU) || frame.len > (fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN)) continue;
    if ((frame.can_id & CAN_ERR_FLAG) != 0) {
      errors_->warn("the bus reports an error, of the class " + text_of({frame.can_id & CAN_ERR_MASK, true}));
      continue;
    }
    if (!active_) continue;
    const bool extended = (frame.can_id & CAN_EFF_FLAG) != 0;
    Message message;
    message.properties.set(id_property, text_of({frame.can_id & (extended ? CAN_EFF_MASK : CAN_SFF_MASK), extended}));
    if (extended) message.properties.set(extended_property, "true");
    if (fd) message.properties.set(fd_property, "true");
    const bool remote = (frame.can_id & CAN_RTR_FLAG) != 0;
    if (remote) message.properties.set(remote_property, "true");
    if (!remote) message.payload = Payload::copy(std::as_bytes(std::span(frame.data).first(frame.len)));
    if (!publish(message)) return;
  }
}

bool CanDriver::publish(const Message& message) {
  if (context_->publish(received_channel, message) != PublishStatus::would_block) return true;
  unpublished_ = message;
  if (readable_) context_->stop(*std::exchange(readable_, std::nullopt));
  return false;
}

void CanDriver::on_writable(std::string_view channel) {
  if (channel != received_channel || !unpublished_) return;
  const Message message = *std::exchange(unpublished_, std::nullopt);
  if (publish(message) && socket_ >= 0 && !readable_) watch();
}

void CanDriver::on_message(std::string_view channel, Message message) {
  if (channel != send_channel) return;
  if (const std::string problem = send(message); !problem.empty())
    lost_->warn("a frame for the bus is lost: " + problem);
}

std::string CanDriver::send(const Message& message) {
  const std::string* own = message.properties.find(id_property);
  const auto id = read_id(own ? *own : send_id_);
  if (!id)
    return "\"" + (own ? *own : send_id_) + "\" is no id: give the message the property id, or the driver send_id";
  const bool fd = wanted_.fd && (is_true(message, fd_property) || message.payload.size() > CAN_MAX_DLEN);
  if (message.payload.size() > (fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN))
    return std::to_string(message.payload.size()) + " bytes are too many" +
           (wanted_.fd ? "" : " (without the property fd)");
  canfd_frame frame{};
  frame.can_id = id->number | (id->extended || is_true(message, extended_property) ? CAN_EFF_FLAG : 0) |
                 (is_true(message, remote_property) && !fd ? CAN_RTR_FLAG : 0);
  frame.len = static_cast<std::uint8_t>(message.payload.size());
  if (!message.payload.empty()) std::memcpy(frame.data, message.payload.data(), message.payload.size());
  if (socket_ < 0) return "the bus is away";
  return ::write(socket_, &frame, fd ? CANFD_MTU : CAN_MTU) < 0 ? std::strerror(errno) : "";
}

}  // namespace iotcloud::drivers::can
