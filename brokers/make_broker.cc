#include <algorithm>
#include <array>

#include "iotcloud/brokers/activemq/activemq_broker.h"
#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/embedded/embedded_broker.h"
#include "iotcloud/brokers/kafka/kafka_broker.h"
#include "iotcloud/brokers/rabbitmq/rabbitmq_broker.h"
#include "iotcloud/config/error.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers {
namespace {

using Maker = std::unique_ptr<Broker> (*)(const BrokerOptions&, const std::vector<BrokerUrl>&);

struct Scheme {
  const char* name;
  const char* kind;
  Maker make;
};

constexpr std::array schemes{
    Scheme{"embedded", "embedded", embedded::make_embedded_broker},
    Scheme{"amqp", "rabbitmq", rabbitmq::make_rabbitmq_broker},
    Scheme{"amqps", "rabbitmq", rabbitmq::make_rabbitmq_broker},
    Scheme{"kafka", "kafka", kafka::make_kafka_broker},
    Scheme{"kafkas", "kafka", kafka::make_kafka_broker},
    Scheme{"activemq", "activemq", activemq::make_activemq_broker},
    Scheme{"activemqs", "activemq", activemq::make_activemq_broker},
};

const Scheme& scheme_of(const std::string& url) {
  const std::string name = parse_broker_url(url).scheme;
  const auto* found =
      std::find_if(schemes.begin(), schemes.end(), [&](const Scheme& scheme) { return scheme.name == name; });
  if (found != schemes.end()) return *found;
  std::string known;
  for (const Scheme& scheme : schemes) known += (known.empty() ? "" : ", ") + std::string(scheme.name);
  throw config::Error("broker URL \"" + printable_url(url) + "\": no broker has the scheme \"" + name +
                      "\"; there are: " + known);
}

}  // namespace

const std::vector<std::string>& broker_kinds() {
  static const std::vector<std::string> kinds = [] {
    std::vector<std::string> all;
    for (const Scheme& scheme : schemes) {
      if (all.empty() || all.back() != scheme.kind) all.emplace_back(scheme.kind);
    }
    return all;
  }();
  return kinds;
}

std::string broker_kind(const std::string& url) {
  return scheme_of(url).kind;
}

std::string to_string(ConnectionState state) {
  switch (state) {
    case ConnectionState::connected:
      return "connected";
    case ConnectionState::blocked:
      return "takes no messages";
    case ConnectionState::connecting:
    case ConnectionState::closed:
      break;
  }
  return "away";
}

std::unique_ptr<Broker> make_broker(const BrokerOptions& options) {
  if (options.urls.empty()) throw config::Error("a broker needs at least one URL");
  const Scheme& scheme = scheme_of(options.urls.front());
  std::vector<BrokerUrl> urls;
  for (const std::string& url : options.urls) {
    urls.push_back(parse_broker_url(url));
    if (urls.back().scheme == scheme.name) continue;
    throw config::Error("the servers of one broker must have one scheme; \"" + printable_url(options.urls.front()) +
                        "\" and \"" + printable_url(url) + "\" have not");
  }
  return scheme.make(options, urls);
}

}  // namespace iotcloud::brokers
