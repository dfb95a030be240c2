#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include <sys/socket.h>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers::stream {

/// An address of IPv4 or IPv6 with a port.
struct Address {
  sockaddr_storage storage{};
  socklen_t size = sizeof(sockaddr_storage);

  sockaddr* get() { return reinterpret_cast<sockaddr*>(&storage); }
  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&storage); }
  int family() const { return storage.ss_family; }
  std::string text() const;  ///< "127.0.0.1:80", "[::1]:80"
  friend bool operator==(const Address& a, const Address& b) { return a.text() == b.text(); }
};

/// "HOST:PORT" in its two parts; the brackets of an IPv6 address go.
struct HostPort {
  std::string host;
  std::uint16_t port = 0;
};

/// \param property its name, for messages. \throws std::invalid_argument for other texts.
HostPort split_address(const std::string& property, const std::string& text);
/// Reads "ADDRESS:PORT" with a number or localhost. \throws std::invalid_argument for other texts.
Address read_address(const std::string& property, const std::string& text);
/// The address at which a socket is bound.
Address address_of(int socket);

/// Asks for the addresses of machines' names on a thread of its own, because that blocks. The instance's event thread
/// makes all calls.
class Resolver {
 public:
  explicit Resolver(DriverContext& context) : context_(context) {}
  /// Waits until a question that is under way is answered: as long as the system's resolver takes at most.
  ~Resolver();
  Resolver(const Resolver&) = delete;
  Resolver& operator=(const Resolver&) = delete;

  /// The addresses, one at least, the most promising first; or why there is none.
  using Answer = std::variant<std::vector<Address>, std::string>;
  /// Calls back on the event thread, or at once for a number; not after the destructor, nor after another call.
  void resolve(const HostPort& name, std::function<void(const Answer&)> callback);

 private:
  DriverContext& context_;
  std::thread thread_;
  std::shared_ptr<bool> wanted_;  ///< by the last question; set to false when nobody waits for it
};

/// Makes a TCP connection send at once what is small, and find out by itself that the other end is gone.
void prepare_connection(int socket);

/// Connects to a TCP port: tries one address of its machine after the other. The instance's event thread makes all
/// calls.
class Dialer {
 public:
  explicit Dialer(DriverContext& context) : context_(context), resolver_(context) {}
  ~Dialer() { stop(); }
  Dialer(const Dialer&) = delete;
  Dialer& operator=(const Dialer&) = delete;

  using Answer = std::variant<int, std::string>;  ///< a connected socket that never blocks, or why there is none
  /// Calls back once, with a socket that is the callback's; not after the destructor, nor after another call.
  void dial(const HostPort& name, std::function<void(const Answer&)> callback);

 private:
  void connect();
  void connected(int socket);
  void stop();
  void fail(const std::string& why);

  DriverContext& context_;
  Resolver resolver_;
  std::string whom_;
  std::function<void(const Answer&)> callback_;
  std::vector<Address> addresses_;  ///< to be tried, the next one at the back
  int socket_ = -1;                 ///< it is being connected
  std::optional<HandlerId> writable_, limit_;
};

}  // namespace iotcloud::drivers::stream
