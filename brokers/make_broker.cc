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
  const BrokerUrl url = parse_broker_url(options.url);
  if (url.scheme == "embedded") return embedded::make_embedded_broker(options, url.host);
  if (url.scheme == "amqp") return rabbitmq::make_rabbitmq_broker(options, url);
  throw config::Error("broker URL \"" + printable_url(options.url) + "\": no broker has the scheme \"" + url.scheme +
                      "\"; there are: embedded, amqp (RabbitMQ)");
}

}  // namespace iotcloud::brokers
