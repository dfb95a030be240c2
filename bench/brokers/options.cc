#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>

#include <iotcloud/bench/brokers/load.h>
#include <iotcloud/bench/brokers/options.h>

namespace iotcloud::bench {

namespace {

constexpr const char* usage_text =
    "usage: %s --url URL --name PREFIX [--drivers N] [--shared] [--size BYTES] [--rate EACH_DRIVER | --under-way N | "
    "--idle] [--no-confirms] [--no-acknowledgements] [--devices-only] [--warm-up S] [--seconds S] [--server PID]... "
    "[--processor PID]...\n";

}  // namespace

std::optional<BrokerOptions> parse_broker_options(int argc, char** argv) {
  BrokerOptions options;
  const std::map<std::string, std::function<void()>> flags{
      {"--shared", [&] { options.shared = true; }},
      {"--idle", [&] { options.idle = true; }},
      {"--no-confirms", [&] { options.confirms = false; }},
      {"--no-acknowledgements", [&] { options.acknowledgements = false; }},
      {"--devices-only", [&] { options.devices_only = true; }},
  };
  const auto whole = [](const char* text) { return std::strtoul(text, nullptr, 10); };
  const std::map<std::string, std::function<void(const char*)>> values{
      {"--url", [&](const char* text) { options.url = text; }},
      {"--name", [&](const char* text) { options.name = text; }},
      {"--drivers", [&](const char* text) { options.drivers = static_cast<unsigned>(whole(text)); }},
      {"--size", [&](const char* text) { options.size = whole(text); }},
      {"--rate", [&](const char* text) { options.rate = std::strtod(text, nullptr); }},
      {"--under-way", [&](const char* text) { options.under_way = static_cast<unsigned>(whole(text)); }},
      {"--warm-up", [&](const char* text) { options.warm_up = std::strtod(text, nullptr); }},
      {"--seconds", [&](const char* text) { options.seconds = std::strtod(text, nullptr); }},
      {"--server", [&](const char* text) { options.server.push_back(static_cast<pid_t>(whole(text))); }},
      {"--processor", [&](const char* text) { options.processors.push_back(static_cast<pid_t>(whole(text))); }},
  };
  bool understood = true;
  for (int i = 1; i < argc; ++i) {
    if (const auto flag = flags.find(argv[i]); flag != flags.end()) {
      flag->second();
    } else if (const auto value = values.find(argv[i]); value != values.end() && i + 1 < argc) {
      value->second(argv[++i]);
    } else {
      understood = false;
    }
  }
  if (understood && !options.url.empty() && !options.name.empty() && options.drivers > 0 && options.seconds > 0 &&
      options.size >= sizeof(Stamp)) {
    return options;
  }
  std::fprintf(stderr, usage_text, argv[0]);
  return std::nullopt;
}

}  // namespace iotcloud::bench
