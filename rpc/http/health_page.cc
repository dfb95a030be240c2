#include <utility>

#include <iotcloud/rpc/http/health_page.h>

namespace iotcloud::rpc {

HttpHandler health_page(std::function<std::string()> trouble) {
  return [trouble = std::move(trouble)](const HttpRequest&) {
    const std::string why = trouble();
    return HttpAnswer{why.empty() ? 200 : 503, "text/plain; charset=utf-8", (why.empty() ? "ok" : why) + "\n"};
  };
}

}  // namespace iotcloud::rpc
