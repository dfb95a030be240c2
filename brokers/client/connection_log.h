#pragma once

#include <set>
#include <string>
#include <utility>

#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::client {

/// Logs once that the broker cannot be reached (once for each reason, because each server may have its own), and once
/// that it is reachable again, for all connections of a broker object together. Thread safe.
class ConnectionLog {
 public:
  /// \param url without its password
  explicit ConnectionLog(std::string url) : url_(std::move(url)) {}
  void failed(const std::string& reason) { failed(url_, reason); }  ///< an attempt to connect failed
  void lost(const std::string& reason) { lost(url_, reason); }      ///< an open connection was lost
  void connected() { connected(url_); }
  /// The same for one of several servers; `server` is its URL without the password.
  void failed(const std::string& server, const std::string& reason);
  void lost(const std::string& server, const std::string& reason);
  void connected(const std::string& server);
  /// Why the last attempt failed, or the connection was lost; empty: since then one was made.
  std::string problem() const;

 private:
  /// Whether `text` is new since the last change.
  static bool first(std::set<std::string>& said, const std::string& text);

  const std::string url_;
  mutable config::Mutex mutex_;
  std::string problem_ IOTCLOUD_GUARDED_BY(mutex_);
  bool said_lost_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::set<std::string> said_failures_ IOTCLOUD_GUARDED_BY(mutex_);
  std::set<std::string> said_connected_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::brokers::client
