#include <filesystem>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/rpc/listen_settings.h>

namespace iotcloud::rpc {

std::string exposure(const ListenSettings& settings) {
  return config::exposure(settings.host, !settings.tls.empty(), !settings.tokens.empty(), "give orders");
}

HostAndPort split_address(const std::string& address) {
  const auto colon = address.rfind(':');
  if (colon != std::string::npos && colon > 0) {
    const std::string digits = address.substr(colon + 1);
    const bool is_number =
        !digits.empty() && digits.size() <= 5 && digits.find_first_not_of("0123456789") == std::string::npos;
    const int port = is_number ? std::stoi(digits) : 0;
    std::string host = address.substr(0, colon);
    if (host.starts_with('[') && host.ends_with(']')) host = host.substr(1, host.size() - 2);
    if (port > 0 && port < 65536 && !host.empty()) return {host, port};
  }
  throw config::Error(fmt::format("\"{}\" is no address: give HOST:PORT, for example 127.0.0.1:12904", address));
}

namespace {

/// Reads how many calls a second each identity of a role may make.
void read_calls(config::YamlSection& section, CallsByRole& calls) {
  auto rates = section.optional_section("calls_per_second");
  if (!rates) return;
  for (auto& [role, limits] : calls)
    limits.per_second =
        static_cast<double>(rates->int_or(to_string(role), static_cast<std::int64_t>(limits.per_second), 1, 1'000'000));
  rates->finish();
}

}  // namespace

void read_listen_settings(config::YamlSection& section, ListenSettings& settings, int least_port) {
  settings.host = section.string_or("host", settings.host);
  settings.port = static_cast<int>(section.int_or("port", settings.port, least_port, 65535));
  settings.tls = security::read_tls(section);
  settings.tokens = section.string_or("tokens", settings.tokens);
  if (const std::string problem = exposure(settings); !problem.empty()) {
    section.refuse(
        "host", problem,
        "tls: {ca, certificate, key} (`iotcloud certs init` makes them) and tokens: FILE (`iotcloud token add`), "
        "or 127.0.0.1");
  }
  if (!settings.tokens.empty() && !std::filesystem::exists(settings.tokens)) {
    section.refuse("tokens", "the file \"" + settings.tokens + "\" is not there",
                   "`iotcloud token add NAME --role admin --file " + settings.tokens + "` makes it");
    settings.tokens.clear();
  }
  settings.users = section.strings_or("users", {});
  settings.open = section.bool_or("open", false);
  read_calls(section, settings.calls);
  if (!settings.tokens.empty() && (settings.open || !settings.users.empty())) {
    section.refuse(settings.open ? "open" : "users", "with tokens it is they that say who may act",
                   "leave out one of the two");
  }
  if (const auto advertise = section.optional_string("advertise")) {
    try {
      static_cast<void>(split_address(*advertise));
    } catch (const config::Error& e) {
      section.refuse("advertise", e.what());
    }
    settings.advertise = *advertise;
  } else if (settings.host == "0.0.0.0" || settings.host == "::") {
    section.refuse("host", settings.host + " is every address, and others must be told one",
                   "advertise: \"HOST:PORT\", a name of this machine that is in its certificate");
  } else {
    settings.advertise = settings.host.find(':') == std::string::npos
                             ? fmt::format("{}:{}", settings.host, settings.port)
                             : fmt::format("[{}]:{}", settings.host, settings.port);
  }
}

}  // namespace iotcloud::rpc
