#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/file_stamp.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::security {

/// The roles of users. Each role includes those before it, but an operator may not pass on plugins.
enum class Role {
  anyone,     ///< not authenticated
  viewer,     ///< reads
  master,     ///< a gateway master at a gateway: reads, and passes on plugins that people sent; gives no orders
  operating,  ///< changes how existing programs run: starts, stops, describes, activates. Written "operator"
  admin,      ///< everything; also decides which programs run
};
/// "viewer", "master", "operator", "admin"; "anyone".
std::string to_string(Role role);
/// \throws Error for an unknown name; the message lists the roles.
Role parse_role(const std::string& name);

/// One line of a token file: "NAME:ROLE:scrypt$N$r$p$SALT$HASH" or "NAME:ROLE:scrypt$N$r$p$SALT$HASH:CERTIFICATE", salt
/// and hash in hexadecimal. After ROLE there may be the time from which on the token is worth nothing, in UTC:
/// "ROLE/20271231T235959Z".
struct TokenEntry {
  std::string name;
  Role role = Role::viewer;
  std::string hash;            ///< everything after the role, up to the certificate
  std::string certificate;     ///< the subject of the certificate that the token counts with ("CN=lab1"); empty: any
  std::int64_t expires_s = 0;  ///< Unix time, seconds; 0: never

  friend bool operator==(const TokenEntry&, const TokenEntry&) = default;
};

/// Reads a token file, as `iotcloud token` writes it. Empty lines and lines that begin with '#' are skipped, and lost
/// when the file is written. \throws Error with file and line if it cannot be read or everybody may write it.
std::vector<TokenEntry> read_tokens(const std::string& file);

/// Makes a token and adds it to the file; makes the file, for its owner only, if it is missing.
/// \param certificate the subject of the certificate with which alone the token counts; empty: it counts with any. The
/// role `master` needs one: a daemon's token is of no use to whoever copies it.
/// \param expires_s TokenEntry::expires_s
/// \return the token, NAME.SECRET, which nothing stores. \throws Error if the name has a token already or is malformed.
std::string add_token(const std::string& file, const std::string& name, Role role, const std::string& certificate = "",
                      std::int64_t expires_s = 0);
/// Gives the token of that name another end: the same token counts until then. \return whether there is such a token.
/// \throws Error
bool renew_token(const std::string& file, const std::string& name, std::int64_t expires_s);
/// The end of a token for people: "2027-12-31 23:59:59 UTC"; "" for 0.
std::string expiry_text(std::int64_t expires_s);
/// \return whether a token of that name was removed. \throws Error
bool remove_token(const std::string& file, const std::string& name);

/// Finds the owner of a token. An expired token has no owner. A file that was replaced is read again by itself: what is
/// asked `look_period` later gets the new file's answer. One that is of no use changes nothing, and is logged. Logs a
/// warning of tokens that expire within two weeks,
/// when it reads the file and when a client shows such a token. Thread safe.
class TokenKeeper {
 public:
  static constexpr std::chrono::milliseconds look_period{250};
  /// \param service of the metric iotcloud_token_days_left{service, token}; empty: there is none
  /// \param clock must outlive the keeper
  /// \throws Error as read_tokens().
  explicit TokenKeeper(std::string file, const std::string& service = "",
                       const config::Clock& clock = config::system_clock(),
                       config::Metrics& metrics = config::process_metrics());
  /// Reads the file again. \throws Error; then the tokens that were read before still count.
  void reload();
  /// Takes some ten milliseconds, one call at a time, if the token costs() that: call it once for each connection.
  /// \param certificate the subject of the certificate that came with the token; empty: none.
  /// \param why if given, is told why the token of somebody who has it does not count
  /// \return nullopt if nobody has this token, or if it counts only with another certificate or has expired, which is
  /// logged
  std::optional<TokenEntry> holder(const std::string& token, const std::string& certificate,
                                   std::string* why = nullptr) const;
  /// Whether holder() has to hash the token: it names somebody, and is not the one that was shown for that name last.
  bool costs(const std::string& token) const;
  /// The current role of this entry's owner; nullopt if the token was removed or replaced, or has expired.
  std::optional<Role> role_of(const TokenEntry& entry) const;

 private:
  void look() const;
  void read() const IOTCLOUD_REQUIRES(reading_);
  void warn_of_end(const TokenEntry& entry) const;
  void measure(const std::string& service, std::vector<config::Sample>& samples) const;
  bool is_over(const TokenEntry& entry) const;
  std::optional<TokenEntry> named_by(const std::string& token) const;
  std::string digest_of(const std::string& token) const;
  bool is_verified(const TokenEntry& entry, const std::string& digest) const;
  bool verify(const TokenEntry& entry, const std::string& token) const;

  /// A token that was found to be that of an entry.
  struct Verified {
    std::string hash;    ///< TokenEntry::hash
    std::string digest;  ///< digest_of() the token
  };
  const std::string file_;
  const config::Clock& clock_;
  mutable config::SharedMutex mutex_;
  mutable std::map<std::string, TokenEntry> entries_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by name
  mutable config::Mutex reading_;  ///< one reading at a time: the last one that begins is the last one that counts
  mutable config::FileStamp seen_ IOTCLOUD_GUARDED_BY(reading_){};  ///< of the file, before it was read
  mutable config::Clock::Instant next_look_ IOTCLOUD_GUARDED_BY(reading_){};
  mutable config::Mutex hashing_;  ///< one hash at a time: each takes 16 MiB
  const std::string secret_;       ///< of this process, so that its digests of tokens tell nothing elsewhere
  mutable config::Mutex verifying_;
  mutable std::map<std::string, Verified> verified_ IOTCLOUD_GUARDED_BY(verifying_);  ///< the last of each name
  config::Metrics::SourceRegistration days_left_;                                     ///< last: it reads the entries
};

}  // namespace iotcloud::security
