#pragma once

#include <array>
#include <chrono>
#include <compare>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <sys/socket.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::processes {

/// A place in the network to which a confined process may connect.
struct Place {
  std::string host;        ///< a machine's name in small letters, or an address
  std::uint16_t port = 0;  ///< of TCP
  // clang-tidy 14 takes the zero that it compares with for a pointer: NOLINTNEXTLINE(modernize-use-nullptr)
  friend auto operator<=>(const Place&, const Place&) = default;
};

/// Reads "HOST:PORT"; HOST is a name, an address, or an address of IPv6 in brackets. \throws config::Error
Place parse_place(const std::string& text);
/// Reads places that commas or spaces separate. \throws config::Error
std::vector<Place> parse_places(const std::string& text);
/// As parse_place() reads it.
std::string to_text(const Place& place);

/// An address of IPv6 or IPv4. The latter has its form in IPv6, so that an address is the same however it is written.
struct IpAddress {
  std::array<unsigned char, 16> bytes{};
  std::uint32_t scope = 0;  ///< the interface of a local address
  // clang-tidy 14 takes the zero that it compares with for a pointer: NOLINTNEXTLINE(modernize-use-nullptr)
  friend auto operator<=>(const IpAddress&, const IpAddress&) = default;
};
/// An address and a port of TCP.
struct Endpoint {
  IpAddress address;
  std::uint16_t port = 0;
};
/// What an address of a socket says; nullopt: it is none of IPv4 or IPv6, or too short.
std::optional<Endpoint> endpoint_of(const sockaddr_storage& address, socklen_t size);
/// For people, and for getaddrinfo().
std::string to_text(const IpAddress& address);

/// The places to which a process may connect, and the addresses that the machines named there have. Thread safe.
class AllowedPlaces {
 public:
  /// The addresses of a machine of that name; empty: it has none, or they cannot be found out. \param configured only
  /// of a kind that this machine has, too
  using Resolve = std::function<std::vector<IpAddress>(const std::string& name, bool configured)>;
  AllowedPlaces(const std::vector<Place>& places, Resolve resolve, const config::Clock& clock);

  /// Whether a place names this machine.
  bool has_name(const std::string& name) const;
  /// Asks for the addresses of a machine that a place names, and remembers them.
  std::vector<IpAddress> ask(const std::string& name, bool configured);
  /// Whether a place is this address and port, as far as is known without asking for names.
  bool knows(const Endpoint& endpoint) const;
  /// Whether a place is this address and port. May ask for the names of places with that port.
  bool allows(const Endpoint& endpoint);
  /// Asks again for names that were asked for some time ago. An address that a name has no more is forgotten only
  /// after the name was found to have others, so that a server of names that is away changes nothing.
  void refresh();

 private:
  struct Entry {
    Place place;
    std::optional<IpAddress> address;  ///< nullopt: the host is a name
  };
  struct Known {
    config::Clock::Instant asked, answered;            ///< last
    std::map<IpAddress, config::Clock::Instant> seen;  ///< the addresses, and when each was last found
    /// Names with many addresses show some of them at a time.
    bool forgotten(config::Clock::Instant last_seen) const;
  };
  std::vector<std::string> to_ask(std::uint16_t port) const;

  std::vector<Entry> entries_;
  const Resolve resolve_;
  const config::Clock& clock_;
  mutable config::Mutex mutex_;
  std::map<std::string, Known> known_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::processes
