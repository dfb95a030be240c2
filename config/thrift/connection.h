#pragma once

#include <atomic>
#include <memory>
#include <string>

#include <iotcloud/config/thrift/stream.h>
#include <iotcloud/config/thrift/thrift_server.h>

namespace iotcloud::config {

/// Answers one message. \param answer gets the answer with its length before it; left alone when there is none.
/// \return false when it was no call. \throws apache::thrift::TException when it cannot be read.
bool answer_message(apache::thrift::TProcessor& processor, const std::string& message, int max_items,
                    std::string& answer);

/// One client of a ThriftServer. Private to the server's sources.
class ThriftConnection {
 public:
  /// \param tls null: none
  ThriftConnection(const ThriftServerOptions& options, const ThriftService& service,
                   std::shared_ptr<const TlsContext> tls, int descriptor);

  /// Answers messages until the client goes, breaks a limit or the server stops. Nothing throws.
  void serve() noexcept;
  /// No more messages are read; the answer of the call under way is still sent. Any thread.
  void stop();
  /// Ends it at once. Any thread.
  void cut() { stream_.cut(); }
  bool is_stranger() const { return !trusted_; }

 private:
  using TimePoint = Stream::Clock::time_point;
  void open();
  /// \return the next message, without its length. \throws StreamError, Refused
  std::string read_message();
  void answer(const std::string& message);
  void refuse(const std::string& reason, const std::string& text) const;

  const ThriftServerOptions& options_;
  const ThriftService& service_;
  const std::shared_ptr<const TlsContext> tls_;
  const TimePoint stranger_until_;
  Stream stream_;
  const std::string address_;
  std::shared_ptr<ThriftPeer> peer_;
  std::shared_ptr<apache::thrift::TProcessor> processor_;
  std::atomic<bool> trusted_{false};
  std::atomic<bool> stopping_{false};
};

}  // namespace iotcloud::config
