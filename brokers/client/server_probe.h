#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::client {

/// Finds out whether a server answers, without waiting for it: it opens a TCP connection, sends the protocol's first
/// bytes, and takes any byte as an answer (because a hanging server accepts connections too). One question at a time.
/// Not thread safe. start() may wait until the host's name is resolved.
class ServerProbe {
 public:
  /// \param greeting a client's first bytes; empty: the TCP connection alone is an answer
  ServerProbe(std::string host, std::uint16_t port, std::string greeting, const config::Clock& clock);
  ~ServerProbe();
  ServerProbe(const ServerProbe&) = delete;
  ServerProbe& operator=(const ServerProbe&) = delete;

  bool under_way() const { return under_way_; }
  void start();
  /// Checks for an answer: true, or false when it is certain that none will come within the limit. Nothing while it is
  /// unknown, or if no question is under way.
  std::optional<bool> poll();

 private:
  enum class Step { connecting, greeting };
  bool finish(bool answer);

  static constexpr std::chrono::seconds limit_{2};
  const std::string host_;
  const std::uint16_t port_;
  const std::string greeting_;
  const config::Clock& clock_;
  bool under_way_ = false;
  Step step_ = Step::connecting;
  int socket_ = -1;
  config::Clock::Instant started_{};
};

}  // namespace iotcloud::brokers::client
