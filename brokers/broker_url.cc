#include "iotcloud/brokers/broker_url.h"

#include <algorithm>
#include <cctype>
#include <optional>
#include <string_view>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>

namespace iotcloud::brokers {
namespace {

constexpr const char* url_form =
    R"(a broker's URL has the form "amqp://user:password@host:port/vhost" or "embedded://NAME")";

[[noreturn]] void fail(const std::string& url, const std::string& problem) {
  throw config::Error("broker URL \"" + printable_url(url) + "\": " + problem + "; " + url_form);
}

int hex_value(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  const char lower = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
}

std::string decode(std::string_view part, const std::string& url) {
  std::string out;
  for (std::size_t i = 0; i < part.size(); ++i) {
    if (part[i] != '%') {
      out += part[i];
      continue;
    }
    const bool complete = i + 2 < part.size();
    const int high = complete ? hex_value(part[i + 1]) : -1;
    const int low = complete ? hex_value(part[i + 2]) : -1;
    if (high < 0 || low < 0) fail(url, "\"%\" must be followed by two hexadecimal digits");
    out += static_cast<char>(high * 16 + low);
    i += 2;
  }
  return out;
}

std::uint16_t parse_port(std::string_view text, const std::string& url) {
  const auto port = config::parse_number<std::uint16_t>(text);
  if (!port || *port == 0) fail(url, "the port is not a number from 1 to 65535");
  return *port;
}

void parse_host(std::string_view text, BrokerUrl& parsed, const std::string& url) {
  std::string_view port;
  if (text.starts_with('[')) {
    const auto close = text.find(']');
    if (close == std::string_view::npos) fail(url, "the \"[\" of an IPv6 address is not closed");
    parsed.host = text.substr(1, close - 1);
    port = text.substr(close + 1);
    if (!port.empty() && !port.starts_with(':')) fail(url, "only \":port\" may follow the \"]\"");
  } else {
    const auto colon = text.find(':');
    parsed.host = decode(text.substr(0, colon), url);
    if (colon != std::string_view::npos) port = text.substr(colon);
  }
  if (!port.empty()) parsed.port = parse_port(port.substr(1), url);
  if (parsed.host.empty()) fail(url, "the host (or name) is missing");
}

}  // namespace

BrokerUrl parse_broker_url(const std::string& url) {
  const auto scheme_end = url.find("://");
  if (scheme_end == std::string::npos || scheme_end == 0) fail(url, "\"scheme://\" is missing");
  BrokerUrl parsed;
  parsed.scheme = url.substr(0, scheme_end);
  std::transform(parsed.scheme.begin(), parsed.scheme.end(), parsed.scheme.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  std::string_view rest = std::string_view(url).substr(scheme_end + 3);
  if (const auto at = rest.substr(0, rest.find('/')).rfind('@'); at != std::string_view::npos) {
    const std::string_view user = rest.substr(0, at);
    const auto colon = user.find(':');
    parsed.user = decode(user.substr(0, colon), url);
    if (colon != std::string_view::npos) parsed.password = decode(user.substr(colon + 1), url);
    rest = rest.substr(at + 1);
  }
  const auto slash = rest.find('/');
  parse_host(rest.substr(0, slash), parsed, url);
  if (slash != std::string_view::npos) {
    parsed.has_path = true;
    parsed.path = decode(rest.substr(slash + 1), url);
  }
  return parsed;
}

std::uint16_t server_port(const BrokerUrl& url) {
  constexpr std::uint16_t amqp = 5672, amqps = 5671, kafka = 9092;
  if (url.port != 0) return url.port;
  if (url.scheme.starts_with("kafka")) return kafka;
  return url.scheme.ends_with('s') ? amqps : amqp;
}

std::string printable_url(const std::string& url) {
  const auto scheme_end = url.find("://");
  const std::size_t start = scheme_end == std::string::npos ? 0 : scheme_end + 3;
  const std::string_view rest = std::string_view(url).substr(start);
  // The last '@' of all, so that a password with a raw '/' or '@', which parsing refuses, is hidden too.
  const auto at = rest.rfind('@');
  if (at == std::string_view::npos) return url;
  const auto colon = rest.substr(0, at).find(':');
  if (colon == std::string_view::npos) return url;
  return url.substr(0, start + colon) + ":***" + std::string(rest.substr(at));
}

}  // namespace iotcloud::brokers
