#pragma once

#include <memory>
#include <string>
#include <string_view>

namespace iotcloud::config {

/// SHA-256 (FIPS 180-4) of bytes that come piece by piece. Not thread safe.
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(Sha256&& other) noexcept;
  Sha256& operator=(Sha256&& other) noexcept;

  void add(std::string_view bytes);
  /// 64 hexadecimal digits in lower case. Once; nothing is added afterwards.
  std::string hex();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Of bytes that are all there.
std::string sha256_hex(std::string_view bytes);

/// Whether it is written as Sha256::hex() writes it; such a text is safe as a file's name.
bool is_sha256(std::string_view text);

/// The first twelve digits: enough for people to tell two apart.
std::string short_sha256(const std::string& hex);

}  // namespace iotcloud::config
