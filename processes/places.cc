#include <algorithm>
#include <cctype>
#include <cstring>
#include <set>
#include <utility>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>
#include <iotcloud/processes/places.h>

namespace iotcloud::processes {

namespace {

/// For how long a name must have had other addresses before one is not its own any more.
constexpr std::chrono::minutes remembered_for{5};
constexpr std::chrono::minutes refreshed_after{2};
/// How soon a name is asked for again because of an address that is not known.
constexpr std::chrono::seconds asked_again_after{10};

constexpr std::size_t first_of_ip4 = 12;

IpAddress of_ip4(const in_addr& address) {
  IpAddress mapped;
  mapped.bytes[first_of_ip4 - 2] = mapped.bytes[first_of_ip4 - 1] = 0xff;
  std::memcpy(mapped.bytes.data() + first_of_ip4, &address, sizeof address);
  return mapped;
}

bool is_ip4(const IpAddress& address) {
  in_addr last{};
  std::memcpy(&last, address.bytes.data() + first_of_ip4, sizeof last);
  return address.bytes == of_ip4(last).bytes;
}

/// The address that a text is; nullopt: it is a name.
std::optional<IpAddress> address_in(const std::string& text) {
  addrinfo hints{};
  hints.ai_flags = AI_NUMERICHOST;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (getaddrinfo(text.c_str(), nullptr, &hints, &found) != 0) return std::nullopt;
  sockaddr_storage address{};
  std::memcpy(&address, found->ai_addr, std::min<std::size_t>(found->ai_addrlen, sizeof address));
  const auto endpoint = endpoint_of(address, found->ai_addrlen);
  freeaddrinfo(found);
  return endpoint ? std::optional(endpoint->address) : std::nullopt;
}

/// A machine's name as it is compared.
std::string plain_name(std::string name) {
  std::transform(name.begin(), name.end(), name.begin(),
                 [](unsigned char letter) { return static_cast<char>(std::tolower(letter)); });
  if (name.ends_with('.')) name.pop_back();
  return name;
}

bool may_be_host(const std::string& host) {
  return !host.empty() && !host.starts_with('.') && !host.ends_with("..") &&
         std::all_of(host.begin(), host.end(), [](unsigned char letter) {
           return std::isalnum(letter) != 0 ||
                  std::string_view(".-_:%").find(static_cast<char>(letter)) != std::string::npos;
         });
}

}  // namespace

Place parse_place(const std::string& text) {
  const auto colon = text.rfind(':');
  std::string host = text.substr(0, colon);
  const bool in_brackets = host.size() > 2 && host.starts_with('[') && host.ends_with(']');
  if (in_brackets) host = host.substr(1, host.size() - 2);
  std::uint16_t port = 0;
  if (colon != std::string::npos) port = config::parse_number<std::uint16_t>(text.substr(colon + 1)).value_or(0);
  const bool has_colon = host.find(':') != std::string::npos;
  if (port == 0 || !may_be_host(host) || has_colon != in_brackets || (has_colon && !address_in(host))) {
    throw config::Error(fmt::format(
        "\"{}\" is no place in the network: write HOST:PORT, with a name or an address, or [ADDRESS]:PORT for IPv6",
        text));
  }
  return {plain_name(host), port};
}

std::vector<Place> parse_places(const std::string& text) {
  std::vector<Place> places;
  constexpr const char* between = ", ";
  for (auto begin = text.find_first_not_of(between); begin != std::string::npos;) {
    const auto end = text.find_first_of(between, begin);
    places.push_back(parse_place(text.substr(begin, end - begin)));
    begin = text.find_first_not_of(between, end);
  }
  return places;
}

std::string to_text(const Place& place) {
  const bool has_colon = place.host.find(':') != std::string::npos;
  return has_colon ? fmt::format("[{}]:{}", place.host, place.port) : fmt::format("{}:{}", place.host, place.port);
}

std::optional<Endpoint> endpoint_of(const sockaddr_storage& address, socklen_t size) {
  if (address.ss_family == AF_INET && size >= sizeof(sockaddr_in)) {
    sockaddr_in ip4{};
    std::memcpy(&ip4, &address, sizeof ip4);
    return Endpoint{of_ip4(ip4.sin_addr), ntohs(ip4.sin_port)};
  }
  if (address.ss_family == AF_INET6 && size >= sizeof(sockaddr_in6)) {
    sockaddr_in6 ip6{};
    std::memcpy(&ip6, &address, sizeof ip6);
    Endpoint endpoint{{{}, ip6.sin6_scope_id}, ntohs(ip6.sin6_port)};
    std::memcpy(endpoint.address.bytes.data(), &ip6.sin6_addr, endpoint.address.bytes.size());
    return endpoint;
  }
  return std::nullopt;
}

std::string to_text(const IpAddress& address) {
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (is_ip4(address)) {
    inet_ntop(AF_INET, address.bytes.data() + first_of_ip4, text.data(), text.size());
    return text.data();
  }
  inet_ntop(AF_INET6, address.bytes.data(), text.data(), text.size());
  if (address.scope == 0) return text.data();
  return fmt::format("{}%{}", text.data(), address.scope);
}

AllowedPlaces::AllowedPlaces(const std::vector<Place>& places, Resolve resolve, const config::Clock& clock)
    : resolve_(std::move(resolve)), clock_(clock) {
  for (const Place& place : places) entries_.push_back({place, address_in(place.host)});
}

bool AllowedPlaces::has_name(const std::string& name) const {
  return std::any_of(entries_.begin(), entries_.end(), [plain = plain_name(name)](const Entry& entry) {
    return !entry.address && entry.place.host == plain;
  });
}

std::vector<IpAddress> AllowedPlaces::ask(const std::string& name, bool configured) {
  const std::string plain = plain_name(name);
  auto found = resolve_(plain, configured);
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  Known& known = known_[plain];
  known.asked = now;
  if (found.empty()) return found;
  known.answered = now;
  for (const auto& address : found) known.seen[address] = now;
  std::erase_if(known.seen, [&](const auto& seen) { return known.forgotten(seen.second); });
  return found;
}

bool AllowedPlaces::Known::forgotten(config::Clock::Instant last_seen) const {
  return answered - last_seen >= remembered_for;
}

bool AllowedPlaces::knows(const Endpoint& endpoint) const {
  const config::MutexLock lock(mutex_);
  for (const Entry& entry : entries_) {
    if (entry.place.port != endpoint.port) continue;
    if (entry.address == endpoint.address) return true;
    const auto known = entry.address ? known_.end() : known_.find(entry.place.host);
    if (known == known_.end()) continue;
    if (known->second.seen.contains(endpoint.address)) return true;
  }
  return false;
}

bool AllowedPlaces::allows(const Endpoint& endpoint) {
  if (knows(endpoint)) return true;
  for (const std::string& name : to_ask(endpoint.port)) ask(name, false);
  return knows(endpoint);
}

void AllowedPlaces::refresh() {
  std::vector<std::string> names;
  {
    const auto now = clock_.now();
    const config::MutexLock lock(mutex_);
    for (const auto& [name, known] : known_) {
      if (now - known.asked >= refreshed_after) names.push_back(name);
    }
  }
  for (const auto& name : names) ask(name, false);
}

/// The names of the places with this port that have not been asked for just now.
std::vector<std::string> AllowedPlaces::to_ask(std::uint16_t port) const {
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  std::set<std::string> names;
  for (const Entry& entry : entries_) {
    if (entry.address || entry.place.port != port) continue;
    const auto known = known_.find(entry.place.host);
    if (known == known_.end() || now - known->second.asked >= asked_again_after) names.insert(entry.place.host);
  }
  return {names.begin(), names.end()};
}

}  // namespace iotcloud::processes
