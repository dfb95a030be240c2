#include <array>

#include <fmt/format.h>
#include <openssl/evp.h>
#include <openssl/rand.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/registry_password.h>

namespace iotcloud::security {

std::string random_hex() {
  std::array<unsigned char, 32> bytes{};
  if (RAND_bytes(bytes.data(), static_cast<int>(bytes.size())) != 1)
    throw config::Error("the system gives no random numbers for a secret");
  std::string text;
  for (const unsigned char byte : bytes) text += fmt::format("{:02x}", byte);
  return text;
}

RegistryPassword new_registry_password(const std::string& user) {
  RegistryPassword made;
  made.password = random_hex();
  made.digest = registry_digest(user, made.password);
  return made;
}

std::string registry_digest(const std::string& user, const std::string& password) {
  const std::string both = user + ":" + password;
  std::array<unsigned char, EVP_MAX_MD_SIZE> sum{};
  unsigned size = 0;
  if (EVP_Digest(both.data(), both.size(), sum.data(), &size, EVP_sha1(), nullptr) != 1)
    throw config::Error("OpenSSL cannot compute SHA-1, by which ZooKeeper knows its users");
  std::array<unsigned char, 2 * EVP_MAX_MD_SIZE> text{};
  const int length = EVP_EncodeBlock(text.data(), sum.data(), static_cast<int>(size));
  return {reinterpret_cast<const char*>(text.data()), static_cast<std::size_t>(length)};
}

}  // namespace iotcloud::security
