#pragma once

#include <mutex>
#include <string>

namespace iotcloud::brokers::client {

/// Says once that the broker cannot be reached, and once that it can: for both connections of a broker object together.
/// Thread safe.
class ConnectionLog {
 public:
  /// \param url already without its password
  explicit ConnectionLog(std::string url) : url_(std::move(url)) {}
  void failed(const std::string& reason);  ///< an attempt to connect
  void lost(const std::string& reason);    ///< a connection that was there
  void connected();

 private:
  const std::string url_;
  std::mutex mutex_;
  bool said_away_ = false;       ///< guarded by mutex_
  bool said_connected_ = false;  ///< guarded by mutex_
};

}  // namespace iotcloud::brokers::client
