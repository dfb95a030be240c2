#include <cerrno>
#include <cstring>
#include <stdexcept>
#include <utility>
#include <vector>

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/tcp/tcp_driver.h>

namespace iotcloud::drivers::tcp {

void TcpDriver::read(PropertyReader& reader) {
  ConnectingDriver::read(reader);
  connect_text_ = reader.text("connect", "");
  listen_text_ = reader.text("listen", "");
  most_peers_ = static_cast<std::size_t>(reader.integer("peers", 16, 1, 10'000));
  silence_ = std::chrono::milliseconds(reader.integer("silence_ms", 0, 0, 86'400'000));
  if (connect_text_.empty() == listen_text_.empty()) {
    throw std::invalid_argument(
        "give one of the properties \"connect\" (HOST:PORT of the device) and \"listen\" (ADDRESS:PORT to which "
        "devices "
        "connect)");
  }
  if (!listen_text_.empty() && reader.text("while_away", "drop") == "keep") {
    throw std::invalid_argument(
        "property \"while_away\": \"keep\" is for \"connect\": with \"listen\" it is not known which device comes "
        "back");
  }
  if (!connect_text_.empty()) peer_ = stream::split_address("connect", connect_text_);
  if (!listen_text_.empty()) listen_ = stream::read_address("listen", listen_text_);
}

void TcpDriver::open(DriverContext& context) {
  dialer_.emplace(context);
  turned_away_.emplace(context);
  set_silence(silence_);
  ConnectingDriver::open(context);
}

void TcpDriver::close() {
  dialer_.reset();
  guests_.clear();
  if (listener_ >= 0) ::close(std::exchange(listener_, -1));
  ConnectingDriver::close();
}

void TcpDriver::connect() {
  if (!listen_text_.empty()) return listen();
  dialer_->dial(peer_, [this](const stream::Dialer::Answer& answer) {
    if (const auto* problem = std::get_if<std::string>(&answer)) return away(*problem);
    const int socket = std::get<int>(answer);
    connected(socket, socket, {{"peer", connect_text_}});
  });
}

void TcpDriver::listen() {
  const int listener = ::socket(listen_.family(), SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  constexpr int on = 1, waiting = 64;
  if (listener >= 0) setsockopt(listener, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (listener < 0 || bind(listener, listen_.get(), listen_.size) != 0 || ::listen(listener, waiting) != 0) {
    const std::string why = std::strerror(errno);
    if (listener >= 0) ::close(listener);
    return away("cannot listen at " + listen_text_ + ": " + why);
  }
  listener_ = listener;
  const std::string address = stream::address_of(listener_).text();
  watch_listener();
  context().log(LogLevel::info, "devices may connect to " + address);
  context().update_metadata({{"listen", address}});
  tell_peers();
}

void TcpDriver::watch_listener() {
  acceptable_ = context().on_readable(listener_, [this] { accept(); });
}

void TcpDriver::accept() {
  constexpr std::chrono::milliseconds pause{100};
  stream::Address from;
  const int socket = accept4(listener_, from.get(), &from.size, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (socket < 0 && (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM)) {
    // Whoever wants to connect waits, and would call this function again and again.
    turned_away_->warn(std::string("a device has to wait: ") + std::strerror(errno));
    context().stop(*std::exchange(acceptable_, std::nullopt));
    context().after(pause, [this] { watch_listener(); });
  }
  if (socket < 0) return;
  const std::string name = from.text();
  if (guests_.size() >= most_peers_) {
    ::close(socket);
    return turned_away_->warn(name + " was turned away: " + std::to_string(most_peers_) + " are connected (peers)");
  }
  stream::prepare_connection(socket);
  guests_[name] = std::make_unique<stream::FrameLink>(
      context(), socket, socket, link_options(),
      stream::FrameLink::Handlers{[this, name](const Payload& frame) { return publish(frame, name); },
                                  [this, name](const std::string& reason) {
                                    context().log(LogLevel::info, name + " is away: " + reason);
                                    guests_.erase(std::string(name));
                                    tell_peers();
                                  }});
  tell_peers();
}

void TcpDriver::tell_peers() {
  if (guests_.empty()) return tell_away("no device has connected to " + stream::address_of(listener_).text());
  tell_connected({{"peers", std::to_string(guests_.size())}});
}

std::string TcpDriver::send(const std::string& bytes, const Message& message) {
  if (listener_ < 0) return ConnectingDriver::send(bytes, message);
  if (guests_.empty()) return "no device is connected";
  if (const std::string* name = message.properties.find(peer_property)) {
    const auto guest = guests_.find(*name);
    if (guest == guests_.end()) return "no device is connected from " + *name + ", its property peer";
    return guest->second->send(bytes) ? "" : "the device takes commands too slowly (unsent_bytes)";
  }
  std::string slow;
  for (const auto& [name, guest] : guests_) {
    if (!guest->send(bytes)) slow += (slow.empty() ? "" : ", ") + name;
  }
  return slow.empty() ? "" : slow + " takes commands too slowly (unsent_bytes)";
}

void TcpDriver::resume() {
  ConnectingDriver::resume();
  std::vector<std::string> names;  // a link that resumes may end
  names.reserve(guests_.size());
  for (const auto& guest : guests_) names.push_back(guest.first);
  for (const std::string& name : names) {
    if (const auto guest = guests_.find(name); guest != guests_.end()) guest->second->resume();
  }
}

}  // namespace iotcloud::drivers::tcp
