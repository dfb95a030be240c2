#include <utility>

#include <iotcloud/config/exposition/health_page.h>

namespace iotcloud::config {

HttpHandler health_page(std::function<std::string()> trouble) {
  return [trouble = std::move(trouble)](const HttpRequest&) {
    const std::string why = trouble();
    return HttpAnswer{why.empty() ? 200 : 503, "text/plain; charset=utf-8", (why.empty() ? "ok" : why) + "\n"};
  };
}

}  // namespace iotcloud::config
