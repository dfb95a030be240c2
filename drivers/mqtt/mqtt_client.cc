#include <cerrno>
#include <cstring>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <utility>
#include <variant>

#include <mosquitto.h>
#include <mqtt_protocol.h>
#include <unistd.h>

#include <iotcloud/drivers/mqtt/mqtt_client.h>

namespace iotcloud::drivers::mqtt {

namespace {

constexpr std::chrono::seconds session_limit{10}, misc_period{1};

/// The library, from its first use to the end of the plugin.
void need_library() {
  struct Library {
    Library() { mosquitto_lib_init(); }
    ~Library() { mosquitto_lib_cleanup(); }
  };
  static const Library library;
}

/// What the library answered, for people.
std::string text_of(int status) {
  return status == MOSQ_ERR_ERRNO ? std::strerror(errno) : mosquitto_strerror(status);
}

struct FreeProperties {
  void operator()(mosquitto_property* properties) const { mosquitto_property_free_all(&properties); }
};
using OwnedProperties = std::unique_ptr<mosquitto_property, FreeProperties>;

std::string password_in(const std::string& file) {
  if (file.empty()) return "";
  std::ifstream in(file);
  std::string password;
  if (!std::getline(in, password) || password.empty()) {
    throw std::invalid_argument("property \"password_file\": \"" + file +
                                "\" cannot be read, or its first line is empty");
  }
  return password;
}

bool has_zero(const std::string& text) {
  return text.find('\0') != std::string::npos;
}

}  // namespace

ClientOptions ClientOptions::read(PropertyReader& reader) {
  constexpr int longest_session = 4'000'000;
  ClientOptions options;
  options.url = reader.text("url", "");
  std::string address = options.url;
  options.tls = address.starts_with("mqtts://");
  if (!options.tls && !address.starts_with("mqtt://")) {
    throw std::invalid_argument("property \"url\" is \"" + address +
                                "\"; it takes mqtt://HOST[:1883] or mqtts://HOST[:8883]");
  }
  address = address.substr(address.find("//") + 2);
  if (address.ends_with(']') || address.find(':') == std::string::npos) address += options.tls ? ":8883" : ":1883";
  const stream::HostPort parts = stream::split_address("url", address);
  options.host = parts.host;
  options.port = parts.port;
  options.five = reader.choice("version", "3.1.1", {"3.1.1", "5"}) == "5";
  options.client_id = reader.text("client_id", "");
  options.session_s = static_cast<std::uint32_t>(reader.integer("session_s", 3600, 0, longest_session));
  options.keepalive_s = static_cast<int>(reader.integer("keepalive_s", 30, 5, 65'535));
  options.user = reader.text("user", "");
  options.password_file = reader.text("password_file", "");
  options.ca = reader.text("ca", "");
  options.certificate = reader.text("certificate", "");
  options.key = reader.text("key", "");
  options.most_bytes = stream::read_most_bytes(reader);
  options.pauses = stream::ReconnectPauses::read(reader);
  const bool files = !options.ca.empty() || !options.certificate.empty() || !options.key.empty();
  if (files && !options.tls)
    throw std::invalid_argument("the properties ca, certificate and key need a \"url\" that begins with mqtts://");
  if (options.certificate.empty() != options.key.empty())
    throw std::invalid_argument("give both of the properties certificate and key, or none");
  if (!options.password_file.empty() && options.user.empty())
    throw std::invalid_argument("property \"password_file\" needs the property \"user\"");
  return options;
}

Client::Client(DriverContext& context, ClientOptions options, Events events)
    : context_(context),
      options_(std::move(options)),
      events_(std::move(events)),
      refused_(context),
      dialer_(context),
      retry_(context, options_.pauses) {
  try {
    make();
  } catch (...) {
    mosquitto_destroy(client_);
    throw;
  }
  state_.emplace(context_);
}

Client::~Client() {
  unwatch();
  mosquitto_disconnect(client_);
  mosquitto_destroy(client_);
}

void Client::make() {
  need_library();
  const std::string id = options_.client_id.empty() ? "iotcloud-" + context_.instance_id() : options_.client_id;
  client_ = mosquitto_new(id.c_str(), options_.session_s == 0, this);
  if (!client_) throw std::runtime_error("the MQTT client cannot be made: " + text_of(MOSQ_ERR_ERRNO));
  mosquitto_int_option(client_, MOSQ_OPT_PROTOCOL_VERSION, options_.five ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
  mosquitto_int_option(client_, MOSQ_OPT_TCP_NODELAY, 1);
  mosquitto_connect_callback_set(
      client_, [](mosquitto*, void* client, int code) { static_cast<Client*>(client)->connection_answered(code); });
  mosquitto_subscribe_callback_set(client_, [](mosquitto*, void* client, int, int filters, const int* granted) {
    static_cast<Client*>(client)->subscribed(filters, granted);
  });
  mosquitto_message_v5_callback_set(
      client_, [](mosquitto*, void* client, const mosquitto_message* message, const mosquitto_property* properties) {
        static_cast<Client*>(client)->received(*message, properties);
      });
  mosquitto_publish_callback_set(client_, [](mosquitto*, void* client, int number) {
    auto* self = static_cast<Client*>(client);
    self->last_sent_ = number;
    if (self->events_.on_sent) self->events_.on_sent(number);
  });
  if (!options_.user.empty()) {
    const std::string password = password_in(options_.password_file);
    mosquitto_username_pw_set(client_, options_.user.c_str(), password.empty() ? nullptr : password.c_str());
  }
  if (!options_.tls) return;
  const auto file_or_none = [](const std::string& file) { return file.empty() ? nullptr : file.c_str(); };
  const int status =
      mosquitto_tls_set(client_, file_or_none(options_.ca), options_.ca.empty() ? "/etc/ssl/certs" : nullptr,
                        file_or_none(options_.certificate), file_or_none(options_.key), nullptr);
  if (status != MOSQ_ERR_SUCCESS) {
    throw std::invalid_argument(
        "the files of the properties ca, certificate and key cannot be read, or the key needs a "
        "password: " +
        text_of(status));
  }
}

void Client::connect() {
  if (!may_read()) {
    waits_ = true;
    return;
  }
  // The library waits for the connection, so first one that waits for nobody says whether there is one to be had.
  dialer_.dial({options_.host, options_.port}, [this](const stream::Dialer::Answer& answer) {
    if (const auto* problem = std::get_if<std::string>(&answer)) return away(*problem);
    ::close(std::get<int>(answer));
    start_session();
  });
}

void Client::start_session() {
  mosquitto_property* properties = nullptr;
  if (options_.five) {
    constexpr std::uint32_t room_for_head = 100'000;
    mosquitto_property_add_int32(&properties, MQTT_PROP_SESSION_EXPIRY_INTERVAL, options_.session_s);
    mosquitto_property_add_int32(&properties, MQTT_PROP_MAXIMUM_PACKET_SIZE,
                                 static_cast<std::uint32_t>(options_.most_bytes) + room_for_head);
  }
  const OwnedProperties owned(properties);
  refusal_.clear();
  const int status = mosquitto_connect_bind_v5(client_, options_.host.c_str(), options_.port, options_.keepalive_s,
                                               nullptr, properties);
  if (status != MOSQ_ERR_SUCCESS) return away("cannot connect to " + options_.url + ": " + text_of(status));
  misc_ = context_.every(misc_period, [this] { after_call(mosquitto_loop_misc(client_)); });
  limit_ = context_.after(session_limit, [this] {
    limit_.reset();
    away(options_.url + " does not answer");
  });
  watch();
}

void Client::connection_answered(int code) {
  if (code != 0) {
    refusal_ = options_.five ? mosquitto_reason_string(code) : mosquitto_connack_string(code);
    return;
  }
  connected_ = true;
  if (limit_) context_.stop(*std::exchange(limit_, std::nullopt));
  retry_.reached();
  state_->connected({{"mqtt_broker", options_.url}});
  events_.on_connected();
}

void Client::subscribe(const std::string& filter, int qos) {
  if (const int status = mosquitto_subscribe(client_, nullptr, filter.c_str(), qos); status != MOSQ_ERR_SUCCESS)
    context_.log(LogLevel::error, "the broker is not asked for \"" + filter + "\": " + text_of(status));
}

void Client::subscribed(int filters, const int* granted) {
  constexpr int refusal = 128;
  for (int i = 0; i < filters; ++i) {
    if (granted[i] >= refusal)
      context_.log(LogLevel::error, "the broker refuses a filter of topics: may " +
                                        (options_.user.empty() ? "everybody" : options_.user) + " read it?");
  }
}

void Client::received(const mosquitto_message& message, const mqtt5__property* properties) {
  if (static_cast<std::size_t>(message.payloadlen) > options_.most_bytes)
    return refused_.warn(std::string("a message of ") + message.topic + " is longer than most_bytes");
  events_.on_message(message, properties);
}

std::string Client::publish(const Outgoing& message, int& number) {
  number = 0;
  const std::string& topic = message.topic;
  if (has_zero(topic) || mosquitto_pub_topic_check(topic.c_str()) != MOSQ_ERR_SUCCESS ||
      mosquitto_validate_utf8(topic.c_str(), static_cast<int>(topic.size())) != MOSQ_ERR_SUCCESS)
    return "\"" + topic + "\" is no topic";
  mosquitto_property* properties = nullptr;
  for (const auto& [name, value] : message.user_properties) {
    if (options_.five && !has_zero(name) && !has_zero(value))
      mosquitto_property_add_string_pair(&properties, MQTT_PROP_USER_PROPERTY, name.c_str(), value.c_str());
  }
  const OwnedProperties owned(properties);
  const int status = mosquitto_publish_v5(client_, &number, topic.c_str(), static_cast<int>(message.payload.size()),
                                          message.payload.data(), message.qos, message.retain, properties);
  if (status != MOSQ_ERR_SUCCESS) return text_of(status);
  // It may have been sent already: then the library has called back with its number.
  if (last_sent_ == number) number = 0;
  return "";
}

void Client::refresh() {
  if (may_read() && std::exchange(waits_, false)) return connect();
  watch();
}

void Client::after_call(int status) {
  const bool ended = status != MOSQ_ERR_SUCCESS || mosquitto_socket(client_) < 0;
  const std::string why = !refusal_.empty()            ? "the broker refuses the session: " + refusal_
                          : status == MOSQ_ERR_SUCCESS ? "it ended the connection"
                                                       : text_of(status);
  if (events_.after_step) events_.after_step();
  if (ended) return away(options_.url + ": " + why);
  watch();
}

void Client::watch() {
  // The library has a socket also of a session that was given up, until the next one begins.
  const int socket = misc_ ? mosquitto_socket(client_) : -1;
  if (socket < 0) return;
  if (readable_ && !may_read()) context_.stop(*std::exchange(readable_, std::nullopt));
  if (!readable_ && may_read())
    readable_ = context_.on_readable(socket, [this] { after_call(mosquitto_loop_read(client_, 1)); });
  const bool writes = mosquitto_want_write(client_);
  if (writable_ && !writes) context_.stop(*std::exchange(writable_, std::nullopt));
  if (!writable_ && writes)
    writable_ = context_.on_writable(socket, [this] { after_call(mosquitto_loop_write(client_, 1)); });
}

void Client::unwatch() {
  for (auto* handler : {&readable_, &writable_, &misc_, &limit_}) {
    if (*handler) context_.stop(*std::exchange(*handler, std::nullopt));
  }
}

void Client::away(const std::string& reason) {
  unwatch();
  connected_ = false;
  if (events_.on_away) events_.on_away(reason);
  state_->away(reason);
  retry_.later([this] { connect(); });
}

}  // namespace iotcloud::drivers::mqtt
