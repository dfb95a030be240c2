#include "iotcloud/brokers/rabbitmq/cluster.h"

#include <utility>

#include <fmt/core.h>

#include "iotcloud/brokers/credentials.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

constexpr int fewest_channels = 8;  // a publishing connection needs two
constexpr int most_channels = 65535;
constexpr int shortest_timeout_ms = 1000;
constexpr int longest_timeout_ms = 3'600'000;

QueueType read_queue_type(const std::string& text) {
  if (text == "classic") return QueueType::classic;
  if (text == "quorum") return QueueType::quorum;
  throw config::Error(fmt::format(R"(RabbitMQ's property queue_type is "{}"; it must be "classic" or "quorum")", text));
}

int read_number(const std::string& name, const std::string& text, int fewest, int most) {
  const auto number = config::parse_number<int>(text);
  if (number && *number >= fewest && *number <= most) return *number;
  throw config::Error(fmt::format("RabbitMQ's property {} is \"{}\"; it must be {} to {}", name, text, fewest, most));
}

}  // namespace

Cluster::Cluster(const BrokerOptions& options, std::vector<BrokerUrl> urls)
    : options_(options),
      of_readers_(reader_options(options)),
      urls_(std::move(urls)),
      trust_(std::make_unique<ServerTrust>(options.tls.ca_file, options.tls.revoked_file)) {
  for (const std::string& url : options.urls) names_.push_back(printable_url(url));
  for (const auto& [name, value] : options.properties) {
    if (name == "queue_type") {
      queue_type_ = read_queue_type(value);
    } else if (name == "channels_per_connection") {
      channels_ = read_number(name, value, fewest_channels, most_channels);
    } else if (name == "confirm_timeout_ms") {
      confirm_timeout_ = std::chrono::milliseconds(read_number(name, value, shortest_timeout_ms, longest_timeout_ms));
    } else if (name != "exchange" && name != "reader" && name != "reader_password_file") {
      throw config::Error(
          fmt::format("RabbitMQ knows no property \"{}\"; there are: channels_per_connection, confirm_timeout_ms, "
                      "exchange, queue_type, reader, reader_password_file",
                      name));
    }
  }
}

BrokerOptions Cluster::reader_options(BrokerOptions options) {
  const auto reader = options.properties.find("reader"), file = options.properties.find("reader_password_file");
  if ((reader == options.properties.end()) != (file == options.properties.end()))
    throw config::Error("RabbitMQ's properties reader and reader_password_file go together; one of the two is missing");
  if (reader == options.properties.end()) return options;
  options.user = reader->second;
  options.password_file = file->second;
  options.password_variable.clear();
  return options;
}

std::unique_ptr<AmqpLink> Cluster::connect(std::size_t server, const char* purpose, Login login) const {
  AmqpLinkOptions link;
  link.url = urls_.at(server);
  try {
    Credentials credentials = credentials_for(login == Login::reader ? of_readers_ : options_, link.url);
    link.url.user = std::move(credentials.user);
    link.url.password = std::move(credentials.password);
  } catch (const config::Error& error) {
    throw LinkError(error.what());
  }
  link.tls = options_.tls;
  link.trust = trust_.get();
  link.heartbeat = options_.heartbeat;
  link.rpc_timeout = options_.rpc_timeout;
  link.purpose = purpose;
  link.channels = channels_;
  return std::make_unique<AmqpLink>(link);
}

}  // namespace iotcloud::brokers::rabbitmq
