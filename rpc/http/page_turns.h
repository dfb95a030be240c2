#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <string>

#include <iotcloud/config/clock.h>

namespace iotcloud::rpc {

/// Shares the one thread of a daemon's pages among their readers: who asks without end has a quarter of its time, and
/// waits while others are answered. Used by that thread. Private to the sources of the pages.
class PageTurns {
 public:
  /// \param clock outlives this
  explicit PageTurns(const config::Clock& clock) : clock_(clock) {}

  /// How long until it is this reader's turn; zero: it is.
  config::Clock::Instant::duration wait(const std::string& reader) const;
  /// The thread has made a page for this reader, in this time.
  void took(const std::string& reader, config::Clock::Instant::duration time);
  /// How many readers are remembered: those that have asked lately, and a thousand others.
  std::size_t remembered() const { return due_.size(); }

 private:
  const config::Clock& clock_;
  /// When a reader will have had its share, if it asks for nothing more.
  std::map<std::string, config::Clock::Instant> due_;
};

}  // namespace iotcloud::rpc
