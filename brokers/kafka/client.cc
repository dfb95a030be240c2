#include "iotcloud/brokers/kafka/client.h"

#include <algorithm>
#include <array>
#include <future>
#include <string_view>
#include <thread>
#include <utility>

#include <fmt/core.h>

#include "iotcloud/brokers/credentials.h"
#include <iotcloud/brokers/kafka/logger.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>

namespace iotcloud::brokers::kafka {
namespace {

// How long a client's user waits for its end.
constexpr std::chrono::seconds longest_end{2};
// How often user and password are read again while the servers refuse them.
constexpr std::chrono::milliseconds refresh_period{500};

int number_of(const std::string& name, const std::string& value, int smallest, int largest) {
  const auto number = config::parse_number<int>(value);
  if (number && *number >= smallest && *number <= largest) return *number;
  throw config::Error(fmt::format("the property \"{}\" of a Kafka broker must be a number from {} to {}, not \"{}\"",
                                  name, smallest, largest, value));
}

std::string servers(const KafkaOptions& options) {
  std::string list;
  for (const BrokerUrl& url : options.urls) {
    if (!list.empty()) list += ',';
    const bool ip6 = url.host.find(':') != std::string::npos;
    list += fmt::format("{}{}{}:{}", ip6 ? "[" : "", url.host, ip6 ? "]" : "", server_port(url));
  }
  return list;
}

Settings common_settings(const KafkaOptions& options) {
  const auto ms = [](std::chrono::milliseconds duration, std::int64_t smallest) {
    return std::to_string(std::max<std::int64_t>(duration.count(), smallest));
  };
  Settings settings{
      {"bootstrap.servers", servers(options)},
      {"client.id", "iotcloud"},
      {"socket.nagle.disable", "true"},
      {"socket.keepalive.enable", "true"},
      {"log.connection.close", "false"},
      {"socket.timeout.ms", ms(options.broker.rpc_timeout, 1000)},
      {"socket.connection.setup.timeout.ms", ms(options.broker.rpc_timeout, 1000)},
      {"reconnect.backoff.ms", "50"},
      {"reconnect.backoff.max.ms", "1000"},
      {"message.max.bytes", std::to_string(options.max_message_bytes)},
      {"receive.message.max.bytes", std::to_string(std::max(100'000'000, 2 * options.max_message_bytes))},
      {"topic.metadata.refresh.fast.interval.ms", "100"},
      // Within this time the library notices new topics and partitions.
      {"topic.metadata.refresh.interval.ms", "5000"},
  };
  const Credentials credentials = credentials_for(options.broker, options.urls.front());
  const bool tls = is_secured(options);
  if (!credentials.user.empty()) {
    settings["sasl.mechanisms"] = "PLAIN";
    settings["sasl.username"] = credentials.user;
    settings["sasl.password"] = credentials.password;
  }
  settings["security.protocol"] =
      credentials.user.empty() ? (tls ? "ssl" : "plaintext") : (tls ? "sasl_ssl" : "sasl_plaintext");
  if (!tls) return settings;
  const Tls& files = options.broker.tls;
  if (!files.ca_file.empty()) settings["ssl.ca.location"] = files.ca_file;
  if (!files.certificate_file.empty()) settings["ssl.certificate.location"] = files.certificate_file;
  if (!files.key_file.empty()) settings["ssl.key.location"] = files.key_file;
  if (!files.revoked_file.empty()) settings["ssl.crl.location"] = files.revoked_file;
  return settings;
}

/// The library's own log lines are for debugging; producer and groups log what users need to know, once.
void on_log(const rd_kafka_t*, int, const char* facility, const char* text) {
  logger.debug("{}: {}", facility, text);
}

struct ConfDestroyer {
  void operator()(rd_kafka_conf_t* conf) const { rd_kafka_conf_destroy(conf); }
};
using Conf = std::unique_ptr<rd_kafka_conf_t, ConfDestroyer>;

}  // namespace

bool is_secured(const KafkaOptions& options) {
  return options.urls.front().scheme == "kafkas";
}

KafkaOptions kafka_options(const BrokerOptions& options, const std::vector<BrokerUrl>& urls) {
  KafkaOptions read{options, urls};
  for (const auto& [name, value] : options.properties) {
    if (name == "envelope") {
      if (value != "thrift" && value != "headers") {
        throw config::Error("the property \"envelope\" of a Kafka broker must be thrift or headers, not \"" + value +
                            "\"");
      }
      read.native_headers = value == "headers";
    } else if (name == "partitions") {
      read.partitions = number_of(name, value, 1, 100'000);
    } else if (name == "replication") {
      read.replication = number_of(name, value, 1, 100);
    } else if (name == "max_message_bytes") {
      read.max_message_bytes = number_of(name, value, 1000, 1'000'000'000);
    } else {
      throw config::Error("a Kafka broker has no property \"" + name +
                          "\"; there are: envelope, partitions, replication, max_message_bytes");
    }
  }
  return read;
}

KafkaClient::KafkaClient(rd_kafka_type_t type, const KafkaOptions& options, const Settings& settings, int events) {
  Conf conf(rd_kafka_conf_new());
  std::array<char, 512> problem{};
  Settings all = common_settings(options);
  for (const auto& [name, value] : settings) all[name] = value;
  for (const auto& [name, value] : all) {
    if (rd_kafka_conf_set(conf.get(), name.c_str(), value.c_str(), problem.data(), problem.size()) !=
        RD_KAFKA_CONF_OK) {
      // The library's own message could contain the value.
      throw ClientError("librdkafka does not take the setting " + name);
    }
  }
  rd_kafka_conf_set_log_cb(conf.get(), on_log);
  rd_kafka_conf_set_events(conf.get(), events);
  handle_ = rd_kafka_new(type, conf.get(), problem.data(), problem.size());
  if (handle_ == nullptr) throw ClientError(problem.data());
  static_cast<void>(conf.release());  // the handle owns it now
}

// The library ends the client on a thread of its own, because librdkafka 2.0.2 may wait for ever for a consumer that
// had a partition of a topic that is gone (mended in 2.1.0). All topics are gone from a server that has lost its data.
KafkaClient::~KafkaClient() {
  std::promise<void> ended;
  auto end = ended.get_future();
  std::thread thread([handle = handle_, ended = std::move(ended)]() mutable {
    // NO_CONSUMER_CLOSE, because ConsumerGroup has closed the consumer already, or wants it to end without leaving the
    // group.
    rd_kafka_destroy_flags(handle, RD_KAFKA_DESTROY_F_NO_CONSUMER_CLOSE);
    ended.set_value();
  });
  if (end.wait_for(longest_end) == std::future_status::ready) {
    thread.join();
  } else {
    logger.warn("librdkafka {} does not end a client within {} s; it goes on in the background", rd_kafka_version_str(),
                longest_end.count());
    thread.detach();
  }
}

bool KafkaClient::connected() const {
  // With a time-out of zero the call sends a request if it can, and does not wait for the answer, which may take long
  // from a distant server.
  const rd_kafka_metadata_t* metadata = nullptr;
  const rd_kafka_resp_err_t error = rd_kafka_metadata(handle_, 0, nullptr, &metadata, 0);
  if (error == RD_KAFKA_RESP_ERR_NO_ERROR) rd_kafka_metadata_destroy(metadata);
  return error == RD_KAFKA_RESP_ERR_NO_ERROR || error == RD_KAFKA_RESP_ERR__TIMED_OUT;
}

int KafkaClient::partitions(const std::string& topic, std::chrono::milliseconds limit) const {
  rd_kafka_topic_t* handle = rd_kafka_topic_new(handle_, topic.c_str(), nullptr);
  if (handle == nullptr) return 0;
  const rd_kafka_metadata_t* metadata = nullptr;
  const rd_kafka_resp_err_t error = rd_kafka_metadata(handle_, 0, handle, &metadata, static_cast<int>(limit.count()));
  rd_kafka_topic_destroy(handle);
  if (error != RD_KAFKA_RESP_ERR_NO_ERROR) return 0;
  const bool known = metadata->topic_cnt == 1 && metadata->topics[0].err == RD_KAFKA_RESP_ERR_NO_ERROR;
  const int count = known ? metadata->topics[0].partition_cnt : 0;
  rd_kafka_metadata_destroy(metadata);
  return count;
}

void KafkaClient::refresh_credentials(const KafkaOptions& options, config::Clock::Instant now) {
  if (now - refreshed_ < refresh_period) return;
  refreshed_ = now;
  try {
    const Credentials credentials = credentials_for(options.broker, options.urls.front());
    if (credentials.user.empty()) return;
    if (rd_kafka_error_t* error =
            rd_kafka_sasl_set_credentials(handle_, credentials.user.c_str(), credentials.password.c_str())) {
      rd_kafka_error_destroy(error);  // the library keeps trying the old credentials
    }
  } catch (const config::Error& error) {
    // The library keeps trying the old credentials, whose failure is logged elsewhere.
    logger.debug("{}", error.what());
  }
}

std::string lasting_words(rd_kafka_event_t* event) {
  std::string words = rd_kafka_event_error_string(event);
  words.resize(std::min({words.size(), words.find(" (after "), words.find('\n')}));
  // The library describes one handshake in several ways; OpenSSL's text is in all of them.
  constexpr std::string_view openssl = ":SSL routines::";
  const auto place = words.find(openssl);
  if (place == std::string::npos) return words;
  const auto error = std::min(words.rfind("error:", place), place);
  const auto server = std::min(words.find(": ") + 2, error);
  return words.substr(0, server) + words.substr(error, words.find(':', place + openssl.size()) - error);
}

bool is_about_connection(rd_kafka_resp_err_t error) {
  switch (error) {
    case RD_KAFKA_RESP_ERR__ALL_BROKERS_DOWN:
    case RD_KAFKA_RESP_ERR__TRANSPORT:
    case RD_KAFKA_RESP_ERR__TIMED_OUT:
    case RD_KAFKA_RESP_ERR__RESOLVE:
    case RD_KAFKA_RESP_ERR__AUTHENTICATION:
    case RD_KAFKA_RESP_ERR__SSL:
    case RD_KAFKA_RESP_ERR_SASL_AUTHENTICATION_FAILED:
      return true;
    default:
      return false;
  }
}

void request_topics(const KafkaClient& client, rd_kafka_queue_t* queue, const std::vector<std::string>& names,
                    const KafkaOptions& options) {
  struct TopicDestroyer {
    void operator()(rd_kafka_NewTopic_t* topic) const { rd_kafka_NewTopic_destroy(topic); }
  };
  struct OptionsDestroyer {
    void operator()(rd_kafka_AdminOptions_t* admin) const { rd_kafka_AdminOptions_destroy(admin); }
  };
  std::vector<std::unique_ptr<rd_kafka_NewTopic_t, TopicDestroyer>> topics;
  std::vector<rd_kafka_NewTopic_t*> pointers;
  for (const std::string& name : names) {
    topics.emplace_back(rd_kafka_NewTopic_new(name.c_str(), options.partitions, options.replication, nullptr, 0));
    if (!topics.back()) continue;
    rd_kafka_NewTopic_set_config(topics.back().get(), "max.message.bytes",
                                 std::to_string(options.max_message_bytes).c_str());
    pointers.push_back(topics.back().get());
  }
  const std::unique_ptr<rd_kafka_AdminOptions_t, OptionsDestroyer> admin(
      rd_kafka_AdminOptions_new(client.get(), RD_KAFKA_ADMIN_OP_CREATETOPICS));
  const int limit = static_cast<int>(std::max<std::int64_t>(options.broker.rpc_timeout.count(), 1000));
  rd_kafka_AdminOptions_set_request_timeout(admin.get(), limit, nullptr, 0);
  rd_kafka_AdminOptions_set_operation_timeout(admin.get(), limit, nullptr, 0);
  rd_kafka_CreateTopics(client.get(), pointers.data(), pointers.size(), admin.get(), queue);
}

std::vector<MadeTopic> made_topics(rd_kafka_event_t* event, const std::vector<std::string>& asked) {
  const auto judge = [](std::string name, rd_kafka_resp_err_t error, const char* text) {
    switch (error) {
      case RD_KAFKA_RESP_ERR_NO_ERROR:
      case RD_KAFKA_RESP_ERR_TOPIC_ALREADY_EXISTS:
        return MadeTopic{std::move(name), true, {}};
      case RD_KAFKA_RESP_ERR_TOPIC_AUTHORIZATION_FAILED:
      case RD_KAFKA_RESP_ERR_CLUSTER_AUTHORIZATION_FAILED:
      case RD_KAFKA_RESP_ERR_POLICY_VIOLATION:
      case RD_KAFKA_RESP_ERR__UNSUPPORTED_FEATURE:
      case RD_KAFKA_RESP_ERR__TIMED_OUT:  // the controller did not answer
        // Ask later, because another client may have made the topic.
        return MadeTopic{std::move(name), true, text != nullptr ? text : rd_kafka_err2str(error)};
      default:
        return MadeTopic{std::move(name), false, text != nullptr ? text : rd_kafka_err2str(error)};
    }
  };
  std::vector<MadeTopic> made;
  if (const rd_kafka_resp_err_t error = rd_kafka_event_error(event); error != RD_KAFKA_RESP_ERR_NO_ERROR) {
    for (const std::string& name : asked) made.push_back(judge(name, error, rd_kafka_event_error_string(event)));
    return made;
  }
  std::size_t count = 0;
  const rd_kafka_topic_result_t** results =
      rd_kafka_CreateTopics_result_topics(rd_kafka_event_CreateTopics_result(event), &count);
  for (std::size_t i = 0; i < count; ++i) {
    made.push_back(judge(rd_kafka_topic_result_name(results[i]), rd_kafka_topic_result_error(results[i]),
                         rd_kafka_topic_result_error_string(results[i])));
  }
  return made;
}

}  // namespace iotcloud::brokers::kafka
