#include <algorithm>
#include <array>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <openssl/rand.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/console/sessions.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master {

namespace {

std::string new_secret() {
  std::array<unsigned char, 32> bytes{};
  if (RAND_bytes(bytes.data(), static_cast<int>(bytes.size())) != 1)
    throw config::Error("OpenSSL has no random numbers for a session");
  return fmt::format("{:02x}", fmt::join(bytes, ""));
}

}  // namespace

bool Sessions::is_over(const Session& session) const {
  const auto now = clock_.now();
  return now - session.begun >= options_.longest || now - session.used >= options_.idle;
}

std::string Sessions::begin(security::TokenEntry holder) {
  auto secret = new_secret();
  const config::MutexLock lock(mutex_);
  std::erase_if(sessions_, [&](const auto& each) { return is_over(each.second); });
  const auto is_theirs = [&](const auto& each) { return each.second.holder.name == holder.name; };
  if (static_cast<std::size_t>(std::count_if(sessions_.begin(), sessions_.end(), is_theirs)) >= options_.most_of_one) {
    auto oldest = sessions_.end();
    for (auto each = sessions_.begin(); each != sessions_.end(); ++each) {
      if (is_theirs(*each) && (oldest == sessions_.end() || each->second.begun < oldest->second.begun)) oldest = each;
    }
    sessions_.erase(oldest);
  }
  sessions_[security::sha256_hex(secret)] = {std::move(holder), clock_.now(), clock_.now()};
  return secret;
}

std::optional<security::TokenEntry> Sessions::find(const std::string& secret) {
  if (secret.empty()) return std::nullopt;
  const auto digest = security::sha256_hex(secret);
  const config::MutexLock lock(mutex_);
  const auto found = sessions_.find(digest);
  if (found == sessions_.end()) return std::nullopt;
  if (is_over(found->second)) {
    sessions_.erase(found);
    return std::nullopt;
  }
  found->second.used = clock_.now();
  return found->second.holder;
}

void Sessions::end(const std::string& secret) {
  const auto digest = security::sha256_hex(secret);
  const config::MutexLock lock(mutex_);
  sessions_.erase(digest);
}

std::size_t Sessions::size() const {
  const config::MutexLock lock(mutex_);
  return sessions_.size();
}

std::string cookie_in(const std::string& header, const std::string& name) {
  std::size_t at = 0;
  while (at < header.size()) {
    const auto end = std::min(header.find(';', at), header.size());
    const auto pair = header.substr(at, end - at);
    const auto first = pair.find_first_not_of(' ');
    if (first != std::string::npos && pair.compare(first, name.size() + 1, name + "=") == 0)
      return pair.substr(first + name.size() + 1);
    at = end + 1;
  }
  return "";
}

}  // namespace iotcloud::master
