#include "iotcloud/brokers/client/server_list.h"

#include <algorithm>

namespace iotcloud::brokers::client {

ServerList::ServerList(std::size_t servers, Times times)
    : times_(times), servers_(servers, Server{Backoff(times.first_wait, times.longest_wait), {}}) {}

std::optional<std::size_t> ServerList::due(Instant now) const {
  if (servers_[preferred].not_before <= now) return preferred;
  for (std::size_t step = 1; step <= servers_.size(); ++step) {
    const std::size_t server = (last_tried_ + step) % servers_.size();
    if (servers_[server].not_before <= now) return server;
  }
  return std::nullopt;
}

ServerList::Instant ServerList::next_attempt() const {
  return std::min_element(servers_.begin(), servers_.end(),
                          [](const Server& a, const Server& b) { return a.not_before < b.not_before; })
      ->not_before;
}

void ServerList::failed(std::size_t server, Instant now) {
  current_.reset();
  last_tried_ = server;
  servers_[server].not_before = now + servers_[server].backoff.next();
}

void ServerList::connected(std::size_t server, Instant now) {
  current_ = last_tried_ = server;
  connected_at_ = now;
  next_question_ = now + times_.ask_every;
  answers_since_.reset();
  std::uniform_int_distribution<std::int64_t> spread(0, times_.settled.count() / 2);
  settled_ = times_.settled + std::chrono::milliseconds(spread(random_));
}

void ServerList::lost(Instant now) {
  if (!current_) return;
  Server& server = servers_[*current_];
  if (now - connected_at_ > times_.steady) server.backoff.reset();
  failed(*current_, now);
}

void ServerList::left() {
  current_.reset();
  servers_[preferred].backoff.reset();
  servers_[preferred].not_before = {};
}

bool ServerList::must_ask(Instant now) const {
  return current_ && *current_ != preferred && now >= next_question_;
}

void ServerList::asked(bool answers, Instant now) {
  next_question_ = now + times_.ask_every;
  if (!answers) {
    answers_since_.reset();
  } else if (!answers_since_) {
    answers_since_ = now;
  }
}

bool ServerList::must_move_back(Instant now) const {
  return current_ && *current_ != preferred && answers_since_ && now - *answers_since_ >= settled_;
}

}  // namespace iotcloud::brokers::client
