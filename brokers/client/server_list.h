#pragma once

#include <chrono>
#include <cstddef>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::client {

/// Chooses the server of a cluster for a connection. The first server is preferred; while it is away the others replace
/// it in turn. Each server has its own back-off, so that one that is away does not delay the next. While a connection
/// uses another server, the preferred one is asked from time to time; when it has answered for `settled` in a row, the
/// connection should move back, which restores the intended load. Not thread safe; does no I/O.
class ServerList {
 public:
  using Instant = config::Clock::Instant;
  struct Times {
    std::chrono::milliseconds first_wait{50};  ///< after a failure of the same server; doubles
    std::chrono::milliseconds longest_wait{2000};
    std::chrono::milliseconds steady{2000};     ///< after a connection that lasted this long, waits start small again
    std::chrono::milliseconds ask_every{1000};  ///< how often to ask the preferred server, while on another
    std::chrono::milliseconds settled{5000};    ///< how long it must have answered; up to half as much again at random
  };
  static constexpr std::size_t preferred = 0;

  /// \param servers the number of servers, at least 1
  explicit ServerList(std::size_t servers) : ServerList(servers, Times()) {}
  ServerList(std::size_t servers, Times times);

  std::size_t size() const { return servers_.size(); }
  /// The server to connect to now; nothing before next_attempt().
  std::optional<std::size_t> due(Instant now) const;
  /// When due() will return a server.
  Instant next_attempt() const;
  /// Reports the outcome of an attempt.
  void failed(std::size_t server, Instant now);
  void connected(std::size_t server, Instant now);
  /// The connection was lost.
  void lost(Instant now);
  /// The connection was closed on purpose, to move back: the preferred server is due at once.
  void left();
  /// The connection's server; nothing without a connection.
  std::optional<std::size_t> current() const { return current_; }

  /// Whether it is time to ask the preferred server. False while connected to it, and while not connected.
  bool must_ask(Instant now) const;
  /// Reports whether the preferred server answered.
  void asked(bool answers, Instant now);
  /// Whether to close the connection in favour of the preferred server.
  bool must_move_back(Instant now) const;

 private:
  struct Server {
    Backoff backoff;
    Instant not_before{};
  };
  const Times times_;
  std::vector<Server> servers_;
  std::size_t last_tried_ = 0;
  std::optional<std::size_t> current_;
  Instant connected_at_{};
  Instant next_question_{};
  std::optional<Instant> answers_since_;
  std::chrono::milliseconds settled_{};  ///< including its random part
  std::minstd_rand random_{std::random_device{}()};
};

}  // namespace iotcloud::brokers::client
