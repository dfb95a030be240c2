#pragma once

#include <mutex>
#include <string>

namespace iotcloud::config {

/// Who did what, and what became of it.
struct AuditEntry {
  std::string who;          ///< the token's name; empty: none was asked for, or none was shown
  std::string role;         ///< "operator"
  std::string certificate;  ///< "CN=operator"; empty without TLS
  std::string address;      ///< "192.0.2.7:40112"
  std::string order;        ///< the method: "deploy"
  std::string what;         ///< "turtle.so on lab1"
  std::string outcome;      ///< "done", or why not
  bool refused = false;     ///< it was not let in or not allowed
};

/// A file of orders: a JSON object on each line with `time` (ISO 8601, UTC) and what AuditEntry has. A line is on disk
/// before its order is answered. Thread safe.
class AuditLog {
 public:
  /// Appends to the file, which only its owner may read when it is made here. \throws Error when it cannot be opened.
  explicit AuditLog(std::string file);
  ~AuditLog();
  AuditLog(const AuditLog&) = delete;
  AuditLog& operator=(const AuditLog&) = delete;

  /// A line that cannot be written (a full disk) is logged as an error.
  void write(const AuditEntry& entry);
  /// Goes on in the file of that name: what was there before was moved away. \throws Error, and goes on in the old one.
  void reopen();

 private:
  const std::string file_;
  std::mutex mutex_;
  int descriptor_;  ///< guarded by mutex_
};

}  // namespace iotcloud::config
