#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include <proton/connection_driver.h>
#include <proton/event.h>

#include "iotcloud/brokers/activemq/wire/wire_message.h"
#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/server_trust.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

struct addrinfo;

namespace iotcloud::brokers::activemq {

/// The port in the URL, or the default of its scheme.
std::uint16_t port_of(const BrokerUrl& url);
bool is_tls(const BrokerUrl& url);

/// One TCP connection to a server, with proton's protocol engine on it. Never waits for the server. Callers hold the
/// mutex of the link that owns it.
class Engine {
 public:
  /// Begins to connect. May wait until the host's name is resolved.
  /// \param purpose for the server's list of connections
  /// \throws config::Error for an unknown host name, and for an unreadable certificate or password
  Engine(const BrokerOptions& options, const BrokerUrl& url, const std::string& purpose, const config::Clock& clock,
         ServerTrust& trust);
  ~Engine();
  Engine(const Engine&) = delete;
  Engine& operator=(const Engine&) = delete;

  pn_connection_t* connection() const { return driver_.connection; }
  pn_transport_t* transport() const { return driver_.transport; }
  int socket() const { return socket_; }
  /// What the server shows at the handshake; null: the connection has no TLS, or proton's is not OpenSSL's.
  const std::shared_ptr<ShownChain>& shown() const { return shown_; }
  /// Whether poll() must wait for room to write, too.
  bool wants_to_write() const { return connecting_ || unwritten_; }

  /// Reads from the server, and handles time-outs and heartbeats. New events may follow.
  void receive(bool readable, bool writable);
  /// The next event, or nullptr. Valid until the next call.
  pn_event_t* next_event() { return pn_connection_driver_next_event(&driver_); }
  /// Sends waiting bytes, as far as the socket takes them.
  void send();

 private:
  struct AddressesFreer {
    void operator()(addrinfo* list) const;
  };
  struct DriverDestroyer {
    void operator()(pn_connection_driver_t* driver) const { pn_connection_driver_destroy(driver); }
  };

  void protect(const BrokerOptions& options, const BrokerUrl& url, ServerTrust& trust);
  void connect_next();
  void finish_connecting();
  void fail(int error);
  bool read();  ///< \return whether bytes came

  const config::Clock& clock_;
  std::shared_ptr<ShownChain> shown_;  ///< outlives driver_
  pn_connection_driver_t driver_{};
  std::unique_ptr<pn_connection_driver_t, DriverDestroyer> destroyer_;
  std::unique_ptr<addrinfo, AddressesFreer> addresses_;
  const addrinfo* next_address_ = nullptr;
  int socket_ = -1;
  bool connecting_ = true;
  bool unwritten_ = false;
};

/// The text of an error; "the server closed it" if it has none.
std::string describe(pn_condition_t* condition);
/// Whether the server will never accept a message that it refused for this reason: it is malformed, or too large. All
/// other reasons, also unknown ones and none, may pass: a missing permission, a reached limit, a disk that is full, a
/// server that is stopping.
bool is_final(pn_condition_t* condition);

/// Sends a message; its body may be empty. \return the delivery, which gets its outcome later
pn_delivery_t* send_message(pn_link_t* sender, std::uint64_t tag, std::string_view head, std::string_view body);
/// Reads the bytes of a complete delivery.
WireBytes receive_message(pn_delivery_t* delivery);

}  // namespace iotcloud::brokers::activemq
