#pragma once

#include <map>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <string>
#include <vector>

namespace iotcloud::config {

/// What somebody may do: each role may all that those before it may.
enum class Role {
  anyone,     ///< not known yet
  viewer,     ///< reads
  operating,  ///< changes how what is there runs: starts, stops, describes, activates. Written "operator"
  admin,      ///< everything: decides also which programs run
};
/// "viewer", "operator", "admin"; "anyone".
std::string to_string(Role role);
/// \throws Error for a name that is none, naming those that are.
Role parse_role(const std::string& name);

/// One line of a token file: "NAME:ROLE:scrypt$N$r$p$SALT$HASH", the last two in hexadecimal.
struct TokenEntry {
  std::string name;
  Role role = Role::viewer;
  std::string hash;  ///< everything behind the role

  friend bool operator==(const TokenEntry&, const TokenEntry&) = default;
};

/// A token file, as `iotcloud token` keeps it. Lines that are empty or begin with '#' are skipped when read, and lost
/// when it is written. \throws Error with file and line when it cannot be read or everybody may write it.
std::vector<TokenEntry> read_tokens(const std::string& file);

/// Makes a token and adds it to the file, which is made when it is not there (for its owner only).
/// \return the token, NAME.SECRET; it is kept nowhere. \throws Error: there is one of that name, or a bad name.
std::string add_token(const std::string& file, const std::string& name, Role role);
/// \return whether there was one of that name. \throws Error
bool remove_token(const std::string& file, const std::string& name);

/// Tells whose token it is. Thread safe.
class TokenKeeper {
 public:
  /// \throws Error as read_tokens().
  explicit TokenKeeper(std::string file);
  /// Reads the file again. \throws Error, and then nothing changes.
  void reload();
  /// Takes some ten milliseconds, one call at a time: once for each connection. \return nullopt: nobody's
  std::optional<TokenEntry> holder(const std::string& token) const;
  /// What the holder of this entry may do now: nullopt when the token was taken away or made anew.
  std::optional<Role> role_of(const TokenEntry& entry) const;

 private:
  const std::string file_;
  mutable std::shared_mutex mutex_;
  std::map<std::string, TokenEntry> entries_;  ///< by name; guarded by mutex_
  mutable std::mutex hashing_;                 ///< one hash at a time: each takes 16 MiB
};

}  // namespace iotcloud::config
