#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <ctime>
#include <fstream>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <openssl/crypto.h>
#include <openssl/evp.h>
#include <openssl/rand.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>
#include <iotcloud/security/logger.h>
#include <iotcloud/security/private_file.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::security {

namespace {

constexpr std::size_t secret_bytes = 32;
constexpr std::size_t salt_bytes = 16;
constexpr std::size_t hash_bytes = 32;
/// scrypt's cost: 16 MiB and some ten milliseconds for each hash.
struct Cost {
  std::uint64_t n = 16'384;
  std::uint64_t r = 8;
  std::uint64_t p = 1;
};
constexpr std::uint64_t most_memory = std::uint64_t{64} << 20;

using Bytes = std::vector<unsigned char>;

std::string to_hex(const Bytes& bytes) {
  std::string text;
  for (const unsigned char byte : bytes) text += fmt::format("{:02x}", byte);
  return text;
}

std::optional<Bytes> from_hex(std::string_view text) {
  if (text.empty() || text.size() % 2 != 0) return std::nullopt;
  Bytes bytes(text.size() / 2);
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    const auto byte = config::parse_number<unsigned char>(text.substr(2 * i, 2), 16);
    if (!byte) return std::nullopt;
    bytes[i] = *byte;
  }
  return bytes;
}

Bytes random_bytes(std::size_t size) {
  Bytes bytes(size);
  if (RAND_bytes(bytes.data(), static_cast<int>(size)) != 1)
    throw config::Error("the system gives no random numbers for a token");
  return bytes;
}

std::optional<Bytes> scrypt(const std::string& secret, const Bytes& salt, const Cost& cost) {
  Bytes hash(hash_bytes);
  if (EVP_PBE_scrypt(secret.data(), secret.size(), salt.data(), salt.size(), cost.n, cost.r, cost.p, most_memory,
                     hash.data(), hash.size()) != 1)
    return std::nullopt;
  return hash;
}

std::vector<std::string_view> split(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  while (true) {
    const auto at = text.find(separator);
    parts.push_back(text.substr(0, at));
    if (at == std::string_view::npos) return parts;
    text.remove_prefix(at + 1);
  }
}

struct Hash {
  Cost cost;
  Bytes salt;
  Bytes hash;
};

std::optional<Hash> parse_hash(std::string_view text) {
  const auto parts = split(text, '$');
  if (parts.size() != 6 || parts[0] != "scrypt") return std::nullopt;
  Hash parsed;
  const auto number = [](std::string_view digits, std::uint64_t& value) {
    value = config::parse_number<std::uint64_t>(digits).value_or(0);
    return value > 0 && value <= (1 << 20);
  };
  if (!number(parts[1], parsed.cost.n) || !number(parts[2], parsed.cost.r) || !number(parts[3], parsed.cost.p))
    return std::nullopt;
  const auto salt = from_hex(parts[4]);
  const auto hash = from_hex(parts[5]);
  if (!salt || !hash || hash->size() != hash_bytes) return std::nullopt;
  parsed.salt = *salt;
  parsed.hash = *hash;
  return parsed;
}

bool is_name(std::string_view name) {
  const auto good = [](unsigned char c) { return std::isalnum(c) != 0 || c == '-' || c == '_'; };
  return !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), good);
}

constexpr const char* expiry_format = "%Y%m%dT%H%M%SZ";

std::string written_expiry(std::int64_t expires_s, const char* format) {
  const std::time_t time = expires_s;
  std::tm parts{};
  gmtime_r(&time, &parts);
  char text[64];
  return {text, std::strftime(text, sizeof text, format, &parts)};
}

/// \throws Error
std::int64_t parse_expiry(const std::string& text) {
  std::tm parts{};
  const char* const end = strptime(text.c_str(), expiry_format, &parts);
  const std::int64_t time = end == nullptr || *end != '\0' ? 0 : timegm(&parts);
  if (time <= 0 || written_expiry(time, expiry_format) != text)
    throw config::Error(fmt::format("\"{}\" is no end of a token; it looks like 20271231T235959Z (UTC)", text));
  return time;
}

void write_tokens(const std::string& file, const std::vector<TokenEntry>& entries) {
  std::string text;
  for (const auto& entry : entries) {
    const std::string expiry = entry.expires_s == 0 ? "" : "/" + written_expiry(entry.expires_s, expiry_format);
    text += fmt::format("{}:{}{}:{}{}{}\n", entry.name, to_string(entry.role), expiry, entry.hash,
                        entry.certificate.empty() ? "" : ":", entry.certificate);
  }
  replace_private_file(file, text);
}

}  // namespace

std::string to_string(Role role) {
  switch (role) {
    case Role::anyone:
      return "anyone";
    case Role::viewer:
      return "viewer";
    case Role::master:
      return "master";
    case Role::operating:
      return "operator";
    case Role::admin:
      return "admin";
  }
  return "anyone";
}

Role parse_role(const std::string& name) {
  for (const Role role : {Role::viewer, Role::master, Role::operating, Role::admin})
    if (name == to_string(role)) return role;
  throw config::Error(fmt::format("\"{}\" is no role: there are viewer, operator, admin and master", name));
}

namespace {

/// The role of a daemon counts with that daemon's certificate only. \throws Error
void check_certificate(const TokenEntry& entry) {
  const auto plain = [](unsigned char c) { return c >= ' ' && c != 127; };
  if (!std::all_of(entry.certificate.begin(), entry.certificate.end(), plain))
    throw config::Error(fmt::format("\"{}\" is no subject of a certificate", entry.certificate));
  if (entry.role == Role::master && entry.certificate.empty())
    throw config::Error(fmt::format(
        "the token of {} has the role master, and no certificate: name the master's (--certificate)", entry.name));
}

}  // namespace

std::vector<TokenEntry> read_tokens(const std::string& file) {
  struct stat status {};
  if (stat(file.c_str(), &status) != 0)
    throw config::Error(fmt::format("the token file {} cannot be read: {}", file, std::strerror(errno)));
  if ((status.st_mode & S_IWOTH) != 0)
    throw config::Error(fmt::format("the token file {} can be written by everybody; chmod 600 {}", file, file));
  std::ifstream in(file);
  std::vector<TokenEntry> entries;
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (line.empty() || line.starts_with('#')) continue;
    const auto parts = split(line, ':');
    if (parts.size() < 3 || !is_name(parts[0]) || !parse_hash(parts[2]))
      throw config::Error(fmt::format(
          "{}:{}: not a line NAME:ROLE:HASH or NAME:ROLE:HASH:CERTIFICATE; `iotcloud token add` writes them", file,
          number));
    TokenEntry entry{std::string(parts[0]), Role::viewer, std::string(parts[2]), "", 0};
    const auto slash = parts[1].find('/');
    if (parts.size() > 3) entry.certificate = parts[3].data();  // to the end of the line: a subject may have colons
    try {
      entry.role = parse_role(std::string(parts[1].substr(0, slash)));
      if (slash != std::string_view::npos) entry.expires_s = parse_expiry(std::string(parts[1].substr(slash + 1)));
      check_certificate(entry);
    } catch (const config::Error& e) {
      throw config::Error(fmt::format("{}:{}: {}", file, number, e.what()));
    }
    const auto same = [&](const TokenEntry& other) { return other.name == entry.name; };
    if (std::any_of(entries.begin(), entries.end(), same))
      throw config::Error(fmt::format("{}:{}: there is a token of {} already", file, number, entry.name));
    entries.push_back(std::move(entry));
  }
  if (in.bad()) throw config::Error(fmt::format("the token file {} cannot be read to its end", file));
  return entries;
}

std::string expiry_text(std::int64_t expires_s) {
  return expires_s == 0 ? "" : written_expiry(expires_s, "%Y-%m-%d %H:%M:%S UTC");
}

std::string add_token(const std::string& file, const std::string& name, Role role, const std::string& certificate,
                      std::int64_t expires_s) {
  if (!is_name(name))
    throw config::Error(fmt::format("\"{}\" cannot be a token's name: 1 to 64 letters, digits, '-' and '_'", name));
  check_certificate({name, role, "", certificate, expires_s});
  auto entries = access(file.c_str(), F_OK) == 0 ? read_tokens(file) : std::vector<TokenEntry>{};
  const auto same = [&](const TokenEntry& entry) { return entry.name == name; };
  if (std::any_of(entries.begin(), entries.end(), same))
    throw config::Error(
        fmt::format("{} has a token of {} already; take it away first: iotcloud token remove {} --file {}", file, name,
                    name, file));
  const std::string secret = to_hex(random_bytes(secret_bytes));
  const Bytes salt = random_bytes(salt_bytes);
  const Cost cost;
  const auto hash = scrypt(secret, salt, cost);
  if (!hash) throw config::Error("OpenSSL cannot hash a token with scrypt");
  entries.push_back({name, role,
                     fmt::format("scrypt${}${}${}${}${}", cost.n, cost.r, cost.p, to_hex(salt), to_hex(*hash)),
                     certificate, expires_s});
  write_tokens(file, entries);
  return name + "." + secret;
}

bool remove_token(const std::string& file, const std::string& name) {
  auto entries = read_tokens(file);
  if (std::erase_if(entries, [&](const TokenEntry& entry) { return entry.name == name; }) == 0) return false;
  write_tokens(file, entries);
  return true;
}

bool renew_token(const std::string& file, const std::string& name, std::int64_t expires_s) {
  auto entries = read_tokens(file);
  const auto at = std::find_if(entries.begin(), entries.end(), [&](const auto& entry) { return entry.name == name; });
  if (at == entries.end()) return false;
  at->expires_s = expires_s;
  write_tokens(file, entries);
  return true;
}

namespace {

constexpr std::int64_t seconds_a_day = std::int64_t{24} * 3600;
/// How long before a token expires the log begins to warn of that.
constexpr std::int64_t warning_s = 14 * seconds_a_day;

std::string how_to_renew(const std::string& name, const std::string& file) {
  return fmt::format("`iotcloud token renew {} --days N --file {}`", name, file);
}

}  // namespace

TokenKeeper::TokenKeeper(std::string file, const std::string& service, const config::Clock& clock,
                         config::Metrics& metrics)
    : file_(std::move(file)), clock_(clock), secret_(to_hex(random_bytes(secret_bytes))) {
  reload();
  if (service.empty()) return;
  days_left_ = metrics.add_source([this, service](auto& samples) { measure(service, samples); });
}

void TokenKeeper::measure(const std::string& service, std::vector<config::Sample>& samples) const {
  look();
  const config::ReadLock lock(mutex_);
  for (const auto& [name, entry] : entries_) {
    if (entry.expires_s == 0) continue;
    config::Sample sample;
    sample.name = "iotcloud_token_days_left";
    sample.help = "Days until a token that has an end expires";
    sample.kind = config::Sample::Kind::gauge;
    sample.labels = {{"service", service}, {"token", name}};
    const std::int64_t left_s = entry.expires_s - clock_.wall_ms() / 1000;
    sample.value = std::floor(static_cast<double>(left_s) / seconds_a_day);
    samples.push_back(std::move(sample));
  }
}

bool TokenKeeper::is_over(const TokenEntry& entry) const {
  return entry.expires_s != 0 && clock_.wall_ms() / 1000 >= entry.expires_s;
}

void TokenKeeper::warn_of_end(const TokenEntry& entry) const {
  if (entry.expires_s == 0 || entry.expires_s - clock_.wall_ms() / 1000 >= warning_s) return;
  access_logger.warn("the token of {} {} {}: {}", entry.name, is_over(entry) ? "expired" : "expires",
                     expiry_text(entry.expires_s), how_to_renew(entry.name, file_));
}

void TokenKeeper::reload() {
  const config::MutexLock lock(reading_);
  read();
}

/// Reads the file if it was replaced since it was last read.
void TokenKeeper::look() const {
  const config::MutexLock lock(reading_);
  const auto now = clock_.now();
  if (now < next_look_) return;
  next_look_ = now + look_period;
  if (seen_ == config::stamp_of(file_)) return;
  try {
    read();
    access_logger.info("read the token file {} again", file_);
  } catch (const config::Error& e) {
    access_logger.error("the tokens that were read before still count: {}", e.what());
  }
}

void TokenKeeper::read() const {
  // Before the file is read: look() notices one that is replaced meanwhile, and reads one that is of no use again only
  // when it has changed.
  seen_ = config::stamp_of(file_);
  next_look_ = clock_.now() + look_period;
  std::map<std::string, TokenEntry> fresh;
  for (auto& entry : read_tokens(file_)) fresh[entry.name] = entry;
  if (fresh.empty())
    access_logger.warn("the token file {} is empty: nobody gets in; iotcloud token add NAME --role ROLE --file {}",
                       file_, file_);
  for (const auto& [name, entry] : fresh) warn_of_end(entry);
  const config::WriteLock lock(mutex_);
  entries_ = std::move(fresh);
}

/// The entry of the name with which the token begins.
std::optional<TokenEntry> TokenKeeper::named_by(const std::string& token) const {
  look();
  const auto dot = token.find('.');
  if (dot == std::string::npos) return std::nullopt;
  const config::ReadLock lock(mutex_);
  const auto at = entries_.find(token.substr(0, dot));
  return at == entries_.end() ? std::nullopt : std::optional(at->second);
}

bool TokenKeeper::is_verified(const TokenEntry& entry, const std::string& digest) const {
  const config::MutexLock lock(verifying_);
  const auto known = verified_.find(entry.name);
  return known != verified_.end() && known->second.hash == entry.hash &&
         CRYPTO_memcmp(known->second.digest.data(), digest.data(), digest.size()) == 0;
}

std::string TokenKeeper::digest_of(const std::string& token) const {
  return sha256_hex(secret_ + token);
}

/// Whether the token is that of the entry.
bool TokenKeeper::verify(const TokenEntry& entry, const std::string& token) const {
  const std::string digest = digest_of(token);
  if (is_verified(entry, digest)) return true;
  const config::MutexLock one_at_a_time(hashing_);
  if (is_verified(entry, digest)) return true;  // the one before has just hashed the same token
  const auto wanted = parse_hash(entry.hash);
  const auto hash = scrypt(token.substr(token.find('.') + 1), wanted->salt, wanted->cost);
  if (!hash || CRYPTO_memcmp(hash->data(), wanted->hash.data(), hash_bytes) != 0) return false;
  const config::MutexLock lock(verifying_);
  verified_[entry.name] = {entry.hash, digest};
  return true;
}

bool TokenKeeper::costs(const std::string& token) const {
  const auto entry = named_by(token);
  return entry && !is_verified(*entry, digest_of(token));
}

std::optional<TokenEntry> TokenKeeper::holder(const std::string& token, const std::string& certificate,
                                              std::string* why) const {
  const auto named = named_by(token);
  if (!named || !verify(*named, token)) return std::nullopt;
  const TokenEntry& entry = *named;
  if (!entry.certificate.empty() && entry.certificate != certificate) {
    access_logger.warn("the token of {} counts only with the certificate {}, and comes with {}: it was copied, or {}",
                       entry.name, entry.certificate, certificate.empty() ? "none" : certificate,
                       "that daemon has another certificate now");
    return std::nullopt;
  }
  warn_of_end(entry);
  if (!is_over(entry)) return entry;
  if (why != nullptr)
    *why = fmt::format("the token of {} expired {}: {}", entry.name, expiry_text(entry.expires_s),
                       how_to_renew(entry.name, "FILE"));
  return std::nullopt;
}

std::optional<Role> TokenKeeper::role_of(const TokenEntry& entry) const {
  look();
  const config::ReadLock lock(mutex_);
  const auto at = entries_.find(entry.name);
  if (at == entries_.end() || at->second.hash != entry.hash || at->second.certificate != entry.certificate ||
      is_over(at->second))
    return std::nullopt;
  return at->second.role;
}

}  // namespace iotcloud::security
