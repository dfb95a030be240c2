#pragma once

#include <memory>
#include <string>
#include <string_view>

namespace iotcloud::security {

/// SHA-256 (FIPS 180-4) of bytes that are added piece by piece. Not thread safe.
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(Sha256&& other) noexcept;
  Sha256& operator=(Sha256&& other) noexcept;

  void add(std::string_view bytes);
  /// 64 hexadecimal digits in lower case. Call it once, after the last add().
  std::string hex();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The SHA-256 of complete bytes.
std::string sha256_hex(std::string_view bytes);

/// Whether the text looks like a result of Sha256::hex(); such a text is safe as a file's name.
bool is_sha256(std::string_view text);

/// The first twelve digits: enough for people to tell two files apart.
std::string short_sha256(const std::string& hex);

}  // namespace iotcloud::security
