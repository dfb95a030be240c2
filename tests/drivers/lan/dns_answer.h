#pragma once

#include <string>
#include <vector>

namespace iotcloud::drivers::lan {

/// A number of DNS, of two bytes.
inline std::string number(unsigned value) {
  return {static_cast<char>(value >> 8 & 0xff), static_cast<char>(value & 0xff)};
}

inline std::string name(const std::vector<std::string>& labels) {
  std::string bytes;
  for (const auto& label : labels) bytes += static_cast<char>(label.size()) + label;
  return bytes + '\0';
}

inline std::string record(const std::string& of, unsigned type, const std::string& data, unsigned ttl = 120) {
  return of + number(type) + number(1) + number(0) + number(ttl) + number(static_cast<unsigned>(data.size())) + data;
}

/// What a responder answers of its service _http._tcp: PTR, and in the additional section SRV, TXT and A.
inline std::string answer(const std::string& instance, unsigned ttl = 120) {
  const std::string service = name({"_http", "_tcp", "local"}), whole = name({instance, "_http", "_tcp", "local"});
  const std::string host = name({"Camera", "local"});
  const std::string text = "\x09path=/cam\x0aMODEL=X-10";
  return number(0) + number(0x8400) + number(0) + number(1) + number(0) + number(3) + record(service, 12, whole, ttl) +
         record(whole, 33, number(0) + number(0) + number(8080) + host) + record(whole, 16, text) +
         record(host, 1, std::string("\x0a\x00\x00\x09", 4));
}

}  // namespace iotcloud::drivers::lan
