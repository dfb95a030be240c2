#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/file_stamp.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/security/ed25519.h>

namespace iotcloud::config {
class YamlSection;
}

namespace iotcloud::security {

/// The keys of those who may sign plugins that run here, or orders. What was changed is read again by itself: what is
/// asked `look_period` later gets the answer of the new keys. Keys whose file is gone are no longer trusted, new ones
/// are. What cannot be read is logged, and keeps the keys trusted that were so before and still have a file. Running
/// plugins go on. Thread safe.
class TrustedKeys {
 public:
  static constexpr std::chrono::milliseconds look_period{250};
  struct Options {
    bool require_signature = false;
    /// Files with a public Ed25519 key in PEM, or folders of which every file that ends in .pub or .pem is one.
    std::vector<std::string> trusted_keys;
  };
  /// Trusts no key, and requires no signature.
  TrustedKeys() = default;
  /// \param clock must outlive the keys
  /// \throws config::Error for a key that cannot be read or that every user may write, and if signatures are required
  /// but no key is trusted.
  explicit TrustedKeys(const Options& options, const config::Clock& clock = config::system_clock());

  /// Reads the keys now. \throws config::Error for a key that cannot be read or that every user may write; then only
  /// the keys whose file is gone are no longer trusted.
  void reload();
  /// A number that changes when other keys are trusted, so that an earlier result of admit() may be out of date.
  std::uint64_t generation() const;
  /// Calls back soon after each change of generation() from now on, at most once for several that come together.
  /// \param changed is called on the returned thread, and one call at a time. It may ask these keys anything. It must
  /// not throw, end that thread, or wait for who does.
  /// \return the thread that looks. Its destructor and assignment end it: they wait for a call that is under way, so
  /// hold no lock there that `changed` takes, and afterwards there is none. The keys must outlive it.
  [[nodiscard]] std::jthread on_change(std::function<void()> changed) const;

  bool requires_signature() const { return options_.require_signature; }
  /// The file name of the trusted key that made this signature (plugin_signature.h) of these bytes; empty: none did.
  std::string signer(std::string_view content, std::string_view signature) const;
  /// As signer(). \param what names the plugin in messages. \throws config::Error if a signature is required, and it is
  /// missing or wrong.
  std::string admit(const std::string& what, std::string_view content, std::string_view signature) const;

 private:
  struct Key {
    std::string name;
    PublicKey key;
    std::string file;
  };
  using Keys = std::vector<Key>;                            ///< in the order of Options::trusted_keys
  using Stamps = std::map<std::string, config::FileStamp>;  ///< of the files and folders
  static Keys read(const std::vector<std::string>& paths);
  Stamps stamps() const;
  void look() const;
  void read_again() const IOTCLOUD_REQUIRES(reading_);
  void trust(Keys keys) const;
  std::shared_ptr<const Keys> keys() const;

  const Options options_{};
  const config::Clock& clock_ = config::system_clock();
  mutable config::Mutex reading_;  ///< one reading at a time: the last one that begins is the last one that counts
  mutable Stamps seen_ IOTCLOUD_GUARDED_BY(reading_);  ///< before the files were read
  mutable config::Clock::Instant next_look_ IOTCLOUD_GUARDED_BY(reading_){};
  mutable config::Mutex mutex_;
  mutable std::shared_ptr<const Keys> keys_ IOTCLOUD_GUARDED_BY(mutex_) = std::make_shared<const Keys>();
  mutable std::uint64_t generation_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
};

/// Reads `<prefix>.require_signature` and `<prefix>.trusted_keys` of a daemon's file: who may sign what is sent to it.
std::shared_ptr<TrustedKeys> read_signers(config::YamlSection& file, const std::string& prefix);

/// Reads `<prefix>.require_version` of a daemon's file, and refuses it where no signature is needed: whoever takes a
/// signature away would take the version away with it. \param signers of the same prefix; null: they were refused
bool read_require_version(config::YamlSection& file, const std::string& prefix, const TrustedKeys* signers);

/// Reads `orders.trusted_keys` of a daemon's file: the masters whose orders it follows. \return nullptr: all masters'.
std::shared_ptr<TrustedKeys> read_trusted_masters(config::YamlSection& file);

}  // namespace iotcloud::security
