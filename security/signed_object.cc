#include <fstream>
#include <sstream>
#include <string_view>

#include <fmt/format.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>
#include <iotcloud/security/signed_object.h>

namespace iotcloud::security {

namespace {

constexpr std::string_view key_before = ",\"signature\":\"";
constexpr std::string_view end_after = "\"}";
constexpr std::size_t signature_digits = 2 * signature_bytes;

/// What is signed begins with words that no other signed thing has.
std::string signed_message(const std::string& place, std::string_view object) {
  return fmt::format("iotcloud signed object 1\n{}\n{}", place, object);
}

std::string key_text(const std::string& file) {
  struct stat status {};
  std::ifstream in(file);
  std::ostringstream text;
  if (stat(file.c_str(), &status) != 0 || !(text << in.rdbuf()))
    throw config::Error(fmt::format("the key {} cannot be read; `iotcloud keys new NAME` makes one", file));
  if ((status.st_mode & (S_IRWXG | S_IRWXO)) != 0)
    throw config::Error(fmt::format("the private key {} is open to others than its owner; chmod 600 {}", file, file));
  return text.str();
}

}  // namespace

ObjectSigner::ObjectSigner(const std::string& file) : file_(file), pem_(key_text(file)) {
  static_cast<void>(sign(""));  // so that a wrong key is reported here, and not with the first order
}

std::string ObjectSigner::sign(const std::string& message) const {
  return security::sign(pem_, file_, message);
}

std::string sign_object(const ObjectSigner& key, const std::string& place, const std::string& object) {
  std::string text = object.substr(0, object.rfind('}'));
  text += key_before;
  for (const char byte : key.sign(signed_message(place, object)))
    text += fmt::format("{:02x}", static_cast<unsigned char>(byte));
  text += end_after;
  return text;
}

std::string signer_of_object(const TrustedKeys& keys, const std::string& place, const std::string& bytes) {
  constexpr std::size_t tail = key_before.size() + signature_digits + end_after.size();
  if (bytes.size() <= tail) return "";
  const std::string_view text = bytes;
  const std::string_view added = text.substr(text.size() - tail);
  if (!added.starts_with(key_before) || !added.ends_with(end_after)) return "";
  std::string signature(signature_bytes, '\0');
  for (std::size_t i = 0; i < signature_bytes; ++i) {
    const auto byte = config::parse_number<unsigned char>(added.substr(key_before.size() + 2 * i, 2), 16);
    if (!byte) return "";
    signature[i] = static_cast<char>(*byte);
  }
  const std::string object = std::string(text.substr(0, text.size() - tail)) + "}";
  return keys.signer(signed_message(place, object), signature);
}

}  // namespace iotcloud::security
