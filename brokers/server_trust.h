#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/file_stamp.h>
#include <iotcloud/config/mutex.h>

struct ssl_ctx_st;         // OpenSSL's SSL_CTX
struct stack_st_X509;      // OpenSSL's STACK_OF(X509)
struct x509_st;            // OpenSSL's X509
struct x509_store_ctx_st;  // OpenSSL's X509_STORE_CTX
struct x509_store_st;      // OpenSSL's X509_STORE

namespace iotcloud::brokers {

/// The certificates that the server of one connection showed at the handshake. ServerTrust makes it. Thread safe.
class ShownChain {
 public:
  explicit ShownChain(std::uint64_t after_look) : after_look_(after_look) {}

 private:
  friend class ServerTrust;
  struct Certificates {
    std::shared_ptr<x509_st> own{};            ///< null: it has shown none yet
    std::shared_ptr<stack_st_X509> between{};  ///< those between it and an authority
  };
  /// OpenSSL's callback for a handshake: `shown` is a ShownChain.
  static int verify(x509_store_ctx_st* check, void* shown);
  Certificates certificates() const;

  const std::uint64_t after_look_;  ///< the connection read the files after that many looks at them
  std::uint64_t checked_by_ = 0;    ///< the last version of the files that trusts it; ServerTrust's to use
  mutable config::Mutex mutex_;
  Certificates certificates_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// Whom the connections of one client trust: the servers that an authority in one file has certified, and that no list
/// of revocations in another one names. Follows both files: what replaces them counts for new connections at once, and
/// for open ones within seconds. Thread safe.
class ServerTrust {
 public:
  using Instant = config::Clock::Instant;

  /// Files in PEM form. \param ca_file empty: the system's authorities. \param revoked_file lists of revocations, one
  /// for each authority; empty: none
  ServerTrust(std::string ca_file, std::string revoked_file);

  /// For a new connection whose context has read the authorities: makes its handshake fail if the server's certificate
  /// is on a list, or if its authority has none in the file, and remembers what the server shows. The list is read now.
  /// \return it is to be destroyed after the context's last handshake
  /// \throws config::Error that names a file that cannot be used
  std::shared_ptr<ShownChain> guard(ssl_ctx_st* context);

  /// Why the server of an open connection is not trusted any more: it is on the list now, or its authority is gone;
  /// empty: it still is. It is, too, if its certificate has expired meanwhile, if the list is old or not for its
  /// authority, and as long as a file cannot be read, which is said once. To be called often: it looks at the files
  /// once a second.
  std::string distrust(ShownChain& shown, Instant now);

 private:
  /// How often the files are looked at. They are taken when two looks find the same, because they may be written one
  /// after the other.
  static constexpr std::chrono::milliseconds look_period{1000};

  using Stamps = std::array<config::FileStamp, 2>;
  Stamps stamps() const;
  void look() IOTCLOUD_REQUIRES(mutex_);
  std::shared_ptr<x509_store_st> read() const;

  const std::string ca_file_;
  const std::string revoked_file_;
  config::Mutex mutex_;
  Instant look_at_ IOTCLOUD_GUARDED_BY(mutex_){};
  std::uint64_t looks_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  Stamps seen_ IOTCLOUD_GUARDED_BY(mutex_);                           ///< at the last look
  Stamps used_ IOTCLOUD_GUARDED_BY(mutex_);                           ///< of what store_ has, or at the beginning
  std::shared_ptr<x509_store_st> store_ IOTCLOUD_GUARDED_BY(mutex_);  ///< null: nothing was replaced yet
  std::uint64_t version_ IOTCLOUD_GUARDED_BY(mutex_) = 0;             ///< of store_
  bool complained_ IOTCLOUD_GUARDED_BY(mutex_) = false;               ///< since the files changed
};

}  // namespace iotcloud::brokers
