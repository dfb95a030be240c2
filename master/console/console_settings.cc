#include <algorithm>
#include <filesystem>
#include <memory>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/master/console/console_settings.h>
#include <iotcloud/rpc/http/http_address.h>

namespace iotcloud::master {

namespace {

/// Whether it is "http://HOST:PORT" or "https://HOST:PORT", and nothing that would add a rule to the page's policy.
bool is_origin(const std::string& url) {
  const auto scheme = url.find("://");
  if (scheme == std::string::npos || (url.substr(0, scheme) != "http" && url.substr(0, scheme) != "https"))
    return false;
  const std::string rest = url.substr(scheme + 3);
  const auto fits = [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '.' || c == '-' ||
           c == ':' || c == '[' || c == ']';
  };
  return !rest.empty() && std::all_of(rest.begin(), rest.end(), fits);
}

PagePluginSettings read_page_plugins(config::YamlSection& section) {
  PagePluginSettings settings;
  settings.folders = section.require_strings("folder");
  for (const auto& folder : settings.folders) {
    if (!std::filesystem::is_directory(folder))
      section.refuse("folder", "\"" + folder + "\" is no folder", "a folder of pages, NAME.js and NAME.js.sig");
  }
  security::TrustedKeys::Options keys;
  keys.require_signature = section.bool_or("require_signature", false);
  keys.trusted_keys = section.strings_or("trusted_keys", {});
  section.check(keys.trusted_keys.empty() ? "require_signature" : "trusted_keys",
                [&] { settings.signers = std::make_shared<security::TrustedKeys>(keys); });
  security::PluginVersions::Options versions;
  versions.file = section.string_or("versions", "");
  versions.allow_rollback = section.strings_or("allow_rollback", {});
  versions.require_version = section.bool_or("require_version", false);
  versions.keys = "console.pages";
  if (versions.file.empty()) {
    for (const auto* const key : {"require_version", "allow_rollback"}) {
      if (section.has(key))
        section.refuse(key, "without `versions` no version is remembered", "versions: FILE, which the master writes");
    }
    return settings;
  }
  if (!keys.require_signature)
    section.refuse("versions", "versions are in signatures, which pages need not have here", "require_signature: true");
  section.check("versions", [&] { settings.versions = std::make_shared<security::PluginVersions>(versions); });
  return settings;
}

}  // namespace

ConsoleSettings read_console_settings(config::YamlSection& top, const std::string& tokens) {
  ConsoleSettings settings;
  auto section = top.optional_section("console");
  if (!section) return settings;
  using std::chrono::duration_cast;
  using std::chrono::milliseconds;
  settings.pages.address = section->require_string("address");
  settings.pages.tls = security::read_tls(*section);
  settings.pages.tokens = tokens;
  section->check("address", [&] {
    const auto host = rpc::HttpAddress(settings.pages.address).host;
    const auto problem = config::exposure(host, !settings.pages.tls.empty(), !tokens.empty(), "give orders");
    if (!problem.empty()) {
      section->refuse(
          "address", problem,
          "console: {tls: {ca, certificate, key}} (`iotcloud certs init` makes them) and api: {tokens: FILE} "
          "(`iotcloud token add`), or an address on 127.0.0.1");
    }
  });
  settings.session = duration_cast<milliseconds>(section->duration_or("session", settings.session));
  settings.idle = duration_cast<milliseconds>(section->duration_or("idle", settings.idle));
  settings.names = section->strings_or("names", {});
  settings.others = section->strings_or("others", {});
  for (const auto& other : settings.others) {
    if (!is_origin(other))
      section->refuse("others", "\"" + other + "\" is not the address of a console",
                      "https://HOST:PORT, as a browser reaches the console of another master");
  }
  if (auto pages = section->optional_section("pages")) {
    settings.page_plugins = read_page_plugins(*pages);
    pages->finish();
  }
  section->finish();
  return settings;
}

}  // namespace iotcloud::master
