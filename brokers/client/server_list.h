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

/// Which server of a cluster a connection uses: the first one is preferred, the others stand in for it in turn while it
/// is away. Each server has a back-off of its own, so that one that is away does not delay the next. While a connection
/// is on another server the preferred one is to be asked now and then; once it has answered for `settled` in a row, the
/// connection should move back, so that the load is as it was meant to be. Not thread safe; no I/O of its own.
class ServerList {
 public:
  using Instant = config::Clock::Instant;
  struct Times {
    std::chrono::milliseconds first_wait{50};  ///< after a failure, for the same server; doubles up to
    std::chrono::milliseconds longest_wait{2000};
    std::chrono::milliseconds steady{2000};     ///< after a connection that lasted so long waits start small again
    std::chrono::milliseconds ask_every{1000};  ///< the preferred server, while on another
    std::chrono::milliseconds settled{5000};    ///< it must have answered so long; up to half as much again at random
  };
  static constexpr std::size_t preferred = 0;

  /// \param servers how many there are, at least 1
  explicit ServerList(std::size_t servers) : ServerList(servers, Times()) {}
  ServerList(std::size_t servers, Times times);

  std::size_t size() const { return servers_.size(); }
  /// The server to connect to now; nothing when none is due before next_attempt().
  std::optional<std::size_t> due(Instant now) const;
  /// When due() has something to say.
  Instant next_attempt() const;
  /// What became of an attempt.
  void failed(std::size_t server, Instant now);
  void connected(std::size_t server, Instant now);
  /// The connection broke.
  void lost(Instant now);
  /// The connection was ended on purpose, to move back: the preferred server is due at once.
  void left();
  /// Where the connection is; nothing while there is none.
  std::optional<std::size_t> current() const { return current_; }

  /// Whether it is time to find out if the preferred server answers. False while connected to it, or not at all.
  bool must_ask(Instant now) const;
  /// What the preferred server did when it was asked.
  void asked(bool answers, Instant now);
  /// Whether to end the connection for the preferred server's sake.
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
  std::chrono::milliseconds settled_{};  ///< with its random part
  std::minstd_rand random_{std::random_device{}()};
};

}  // namespace iotcloud::brokers::client
