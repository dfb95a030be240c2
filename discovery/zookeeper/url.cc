#include <algorithm>
#include <string_view>

#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/zookeeper/url.h>

namespace iotcloud::discovery::zookeeper {

Url parse_url(const std::string& url) {
  constexpr std::string_view scheme = "zookeeper://";
  const auto fail = [&](const std::string& problem) {
    return config::Error("registry URL \"" + url + "\": " + problem +
                         "; the form is zookeeper://host:port,host:port/chroot (the chroot may be left out)");
  };
  if (!url.starts_with(scheme)) throw fail("it does not begin with zookeeper://");
  const std::string_view rest = std::string_view(url).substr(scheme.size());
  const std::size_t slash = std::min(rest.find('/'), rest.size());
  Url result;
  result.chroot = rest.substr(slash);
  while (!result.chroot.empty() && result.chroot.back() == '/') result.chroot.pop_back();
  if (!result.chroot.empty()) {
    try {
      check_path(result.chroot);
    } catch (const RegistryError& error) {
      throw fail(error.what());
    }
  }
  const std::string_view hosts = rest.substr(0, slash);
  for (std::size_t begin = 0; begin <= hosts.size();) {
    const std::size_t end = std::min(hosts.find(',', begin), hosts.size());
    const std::string_view address = hosts.substr(begin, end - begin);
    begin = end + 1;
    const auto colon = address.rfind(':');
    const bool has_port = colon != std::string_view::npos && address.find(']', colon) == std::string_view::npos;
    const std::string_view host = has_port ? address.substr(0, colon) : address;
    if (host.empty()) throw fail("a host's name is missing");
    int port = 2181;
    if (has_port) {
      const std::string_view digits = address.substr(colon + 1);
      port = config::parse_number<int>(digits).value_or(0);
      if (port < 1 || port > 65535) {
        throw fail("\"" + std::string(digits) + "\" is no port");
      }
    }
    if (!result.hosts.empty()) result.hosts += ',';
    result.hosts += std::string(host) + ':' + std::to_string(port);
  }
  return result;
}

}  // namespace iotcloud::discovery::zookeeper
