#include <filesystem>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/rpc/http/http_address.h>
#include <iotcloud/rpc/http/page_settings.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::rpc {

std::string exposure(const PageSettings& settings) {
  return config::exposure(HttpAddress(settings.address).host, !settings.tls.empty(), !settings.tokens.empty(),
                          "read the pages");
}

PageSettings read_page_settings(config::YamlSection& file) {
  PageSettings settings;
  auto section = file.optional_section("metrics");
  if (!section) return settings;
  settings.address = section->require_string("address");
  settings.tls = security::read_tls(*section);
  settings.tokens = section->string_or("tokens", "");
  try {
    if (const std::string problem = exposure(settings); !problem.empty()) {
      section->refuse(
          "address", problem,
          "tls: {ca, certificate, key} (`iotcloud certs init` makes them) and tokens: FILE (`iotcloud token add`), "
          "or an address on 127.0.0.1");
    }
  } catch (const config::ConfigError&) {
    throw;
  } catch (const config::Error& e) {
    section->refuse("address", e.what());
  }
  if (!settings.tokens.empty() && section->runs_here()) {
    try {
      security::read_tokens(settings.tokens);
    } catch (const config::Error& e) {
      section->refuse("tokens", e.what(), "`iotcloud token add NAME --role viewer --file FILE` makes one");
    }
  }
  settings.certificates = section->strings_or("certificates", {});
  for (const auto& certificate : settings.certificates) {
    if (section->runs_here() && !std::filesystem::exists(certificate))
      section->refuse(
          "certificates", "the file \"" + certificate + "\" is not there",
          "certificates whose days left /metrics is to show; this daemon's own and its authority's it shows "
          "anyhow");
  }
  section->finish();
  return settings;
}

}  // namespace iotcloud::rpc
