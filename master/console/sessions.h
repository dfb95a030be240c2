#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <optional>
#include <string>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::master {

/// Who has logged in to the console. A session's secret is in its browser's cookie, and only its SHA-256 here; sessions
/// end with the process. Thread safe.
class Sessions {
 public:
  struct Options {
    std::chrono::milliseconds longest{12 * 3'600'000};  ///< from the log-in on
    std::chrono::milliseconds idle{3'600'000};          ///< without a request
    std::size_t most_of_one = 32;                       ///< of one name; one more ends the oldest
  };
  /// \param clock outlives this
  explicit Sessions(Options options, const config::Clock& clock = config::system_clock())
      : options_(options), clock_(clock) {}

  /// Begins a session. \return its secret
  std::string begin(security::TokenEntry holder) IOTCLOUD_EXCLUDES(mutex_);
  /// Whose session it is, which goes on by that; nullopt: there is none, or it is over. The holder's token may have
  /// been taken away meanwhile: ask TokenKeeper::role_of().
  std::optional<security::TokenEntry> find(const std::string& secret) IOTCLOUD_EXCLUDES(mutex_);
  void end(const std::string& secret) IOTCLOUD_EXCLUDES(mutex_);
  std::size_t size() const IOTCLOUD_EXCLUDES(mutex_);

 private:
  struct Session {
    security::TokenEntry holder;
    config::Clock::Instant begun, used;
  };
  bool is_over(const Session& session) const;

  const Options options_;
  const config::Clock& clock_;
  mutable config::Mutex mutex_;
  std::map<std::string, Session> sessions_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by the secrets' SHA-256
};

/// The value of a cookie in the header "Cookie"; empty: it is not there.
std::string cookie_in(const std::string& header, const std::string& name);

}  // namespace iotcloud::master
