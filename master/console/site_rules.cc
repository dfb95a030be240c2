#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/exposure.h>
#include <iotcloud/master/console/site_rules.h>
#include <iotcloud/rpc/http/http_address.h>

namespace iotcloud::master {

namespace {

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](char c) { return static_cast<char>(c >= 'A' && c <= 'Z' ? c + ('a' - 'A') : c); });
  return text;
}

/// "lab1" of "lab1:9114", "::1" of "[::1]".
std::string name_in(const std::string& host) {
  if (host.starts_with('[')) return host.substr(1, host.find(']') - 1);
  return host.substr(0, host.find(':'));
}

std::string header(const rpc::SiteRequest& request, const char* name) {
  const auto found = request.headers.find(name);
  return found == request.headers.end() ? "" : found->second;
}

}  // namespace

SiteRules::SiteRules(const ConsoleSettings& settings) : scheme_(settings.pages.tls.empty() ? "http" : "https") {
  const auto host = lower(rpc::HttpAddress(settings.pages.address).host);
  names_ = {host, "localhost", "127.0.0.1", "::1"};
  if (!config::is_loopback(host)) names_.insert(lower(config::host_name()));
  for (const auto& name : settings.names) names_.insert(lower(name));
  std::string reached = "'self'";
  for (const auto& other : settings.others) reached += " " + other;
  policy_ = fmt::format(
      "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src {}; "
      "frame-src 'self'; "
      "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
      reached);
}

std::string SiteRules::refusal(const rpc::SiteRequest& request) const {
  const auto host = lower(header(request, "host"));
  if (!names_.contains(name_in(host))) {
    return fmt::format("this console is not reached as \"{}\"; if it is meant, name it in console: {{names: [...]}}",
                       name_in(host));
  }
  const bool reads = request.method == "GET";
  if (request.path == "/alive" && reads) return "";  // other masters' consoles ask
  const auto origin = header(request, "origin");
  if (origin.empty() ? !reads : lower(origin) != scheme_ + "://" + host) {
    return origin.empty() ? "a request that is to change something says from which site it comes (Origin)"
                          : fmt::format("a page of {} may not ask here", origin);
  }
  // Whoever follows a link to the console comes from elsewhere, and gets the page, which asks for itself.
  const auto site = header(request, "sec-fetch-site");
  const bool is_visit = reads && request.path == "/" && header(request, "sec-fetch-mode") == "navigate";
  if (!site.empty() && site != "same-origin" && site != "none" && !is_visit)
    return "another site's page may not ask here";
  if (!reads && !request.body.empty() && !header(request, "content-type").starts_with("application/json"))
    return "a body is JSON (Content-Type: application/json)";
  return "";
}

}  // namespace iotcloud::master
