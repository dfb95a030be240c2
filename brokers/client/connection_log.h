#pragma once

#include <mutex>
#include <set>
#include <string>

namespace iotcloud::brokers::client {

/// Says once that the broker cannot be reached (once for each reason: of several servers each may have its own), and
/// once that it can: for all connections of a broker object together. Thread safe.
class ConnectionLog {
 public:
  /// \param url already without its password
  explicit ConnectionLog(std::string url) : url_(std::move(url)) {}
  void failed(const std::string& reason) { failed(url_, reason); }  ///< an attempt to connect
  void lost(const std::string& reason) { lost(url_, reason); }      ///< a connection that was there
  void connected() { connected(url_); }
  /// The same for one of several servers, `server` being its URL without the password.
  void failed(const std::string& server, const std::string& reason);
  void lost(const std::string& server, const std::string& reason);
  void connected(const std::string& server);

 private:
  /// Whether this was not said yet since the last change.
  bool first(std::set<std::string>& said, const std::string& text);

  const std::string url_;
  std::mutex mutex_;
  // All below: guarded by mutex_.
  bool said_lost_ = false;
  std::set<std::string> said_failures_;
  std::set<std::string> said_connected_;
};

}  // namespace iotcloud::brokers::client
