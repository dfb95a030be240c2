#include <array>
#include <cerrno>
#include <cstring>
#include <stdexcept>
#include <utility>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/lan/lan_finder.h>

namespace iotcloud::drivers::lan {

namespace {

constexpr int most_missed = 3;
constexpr int most_heard_at_once = 64;
constexpr std::size_t most_found = 10'000;

}  // namespace

std::vector<ChannelSpec> LanFinder::channels(const PropertyMap& properties) {
  PropertyReader reader(properties);
  std::string to = reader.text("to", "");
  if (to.empty()) to = group_;
  to_ = stream::read_address("to", to);
  if (const std::string from = reader.text("interface", ""); !from.empty())
    from_ = stream::read_address("interface", from + ":0");
  if (to_->family() != AF_INET || (from_ && from_->family() != AF_INET))
    throw std::invalid_argument("the properties \"to\" and \"interface\" take addresses of IPv4");
  constexpr int longest = 86'400, usual = 30;
  period_ = std::chrono::seconds(reader.integer("period_s", usual, 1, longest));
  read_properties(reader);
  return {};
}

void LanFinder::open(DriverContext& context) {
  context_ = &context;
  passed_over_.emplace(context);
  socket_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (socket_ < 0) {
    throw std::runtime_error("no UDP socket is to be had: " + std::string(std::strerror(errno)) +
                             "; a driver host with host_ports or host_network has none");
  }
  if (from_) {
    const in_addr own = reinterpret_cast<const sockaddr_in*>(from_->get())->sin_addr;
    if (::bind(socket_, from_->get(), from_->size) != 0 ||
        ::setsockopt(socket_, IPPROTO_IP, IP_MULTICAST_IF, &own, sizeof own) != 0)
      throw std::runtime_error("the property \"interface\" is no address of this machine: " +
                               std::string(std::strerror(errno)));
  }
  context.on_readable(socket_, [this] { hear(); });
  context.every(period_, [this] { next_round(); });
  ask();
}

void LanFinder::close() {
  if (socket_ >= 0) ::close(std::exchange(socket_, -1));
}

void LanFinder::away(const std::string& reason) {
  if (std::exchange(sees_, false)) {
    context_->report_sight(false);
    missed_.clear();
  }
  context_->update_metadata({{"problem", reason}});
}

void LanFinder::ask() {
  for (const std::string& question : questions()) {
    if (::sendto(socket_, question.data(), question.size(), 0, to_->get(), to_->size) >= 0) continue;
    return away("nobody can be asked at " + to_->text() + ": " + std::strerror(errno));
  }
  if (std::exchange(sees_, true)) return;
  context_->report_sight(true);
  context_->update_metadata({{"problem", ""}});
}

void LanFinder::next_round() {
  for (auto at = missed_.begin(); at != missed_.end();) {
    if (++at->second <= most_missed) {
      ++at;
      continue;
    }
    context_->report_gone(at->first);
    at = missed_.erase(at);
  }
  ask();
}

void LanFinder::hear() {
  std::array<char, 65'536> buffer;
  for (int i = 0; i < most_heard_at_once; ++i) {
    stream::Address from;
    const ssize_t size = ::recvfrom(socket_, buffer.data(), buffer.size(), 0, from.get(), &from.size);
    if (size < 0) return;
    std::array<char, INET_ADDRSTRLEN> text{};
    inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(from.get())->sin_addr, text.data(), text.size());
    const std::string problem = answered({buffer.data(), static_cast<std::size_t>(size)}, text.data());
    if (!problem.empty())
      passed_over_->warn("an answer of " + std::string(text.data()) + " is passed over: " + problem);
  }
}

void LanFinder::found(const std::string& key, const PropertyMap& attributes) {
  if (!missed_.contains(key) && missed_.size() >= most_found) return;
  missed_[key] = 0;
  context_->report_found(key, attributes);
}

}  // namespace iotcloud::drivers::lan
