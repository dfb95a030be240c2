#pragma once

#include <set>
#include <string>

#include <iotcloud/master/console/console_settings.h>
#include <iotcloud/rpc/http/http_site.h>

namespace iotcloud::master {

/// Which requests the console's own pages can have made. A browser also sends what other sites tell it to, and a name
/// of somebody else's may lead to an address on 127.0.0.1 (DNS rebinding): the rules look at the names and the origin
/// that the browser itself writes into each request.
class SiteRules {
 public:
  explicit SiteRules(const ConsoleSettings& settings);

  /// Why the request is refused; empty: it is not.
  std::string refusal(const rpc::SiteRequest& request) const;
  /// The value of the header Content-Security-Policy of every answer: only the site's own files, and no script in a
  /// page.
  const std::string& policy() const { return policy_; }

 private:
  std::string scheme_;
  std::set<std::string> names_;
  std::string policy_;
};

}  // namespace iotcloud::master
