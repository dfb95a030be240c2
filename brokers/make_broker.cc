#include <algorithm>

#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/embedded/embedded_broker.h"
#include "iotcloud/brokers/rabbitmq/rabbitmq_broker.h"
#include "iotcloud/config/error.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers {

const std::vector<std::string>& broker_kinds() {
  static const std::vector<std::string> kinds{"embedded", "rabbitmq"};
  return kinds;
}

std::unique_ptr<Broker> make_broker(const BrokerOptions& options) {
  std::vector<BrokerUrl> urls;
  for (const std::string& url : options.urls) urls.push_back(parse_broker_url(url));
  if (urls.empty()) throw config::Error("a broker needs at least one URL");
  const std::string& scheme = urls.front().scheme;
  const auto other = std::find_if(urls.begin(), urls.end(), [&](const auto& url) { return url.scheme != scheme; });
  if (other != urls.end()) {
    throw config::Error("the servers of one broker must be of one kind; \"" + printable_url(options.urls.front()) +
                        "\" and \"" + printable_url(options.urls[static_cast<std::size_t>(other - urls.begin())]) +
                        "\" are not");
  }
  if (scheme == "embedded") return embedded::make_embedded_broker(options, urls.front().host);
  if (scheme == "amqp" || scheme == "amqps") return rabbitmq::make_rabbitmq_broker(options, urls);
  throw config::Error("broker URL \"" + printable_url(options.urls.front()) + "\": no broker has the scheme \"" +
                      scheme + "\"; there are: embedded, amqp and amqps (RabbitMQ)");
}

}  // namespace iotcloud::brokers
