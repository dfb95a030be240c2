#include <algorithm>
#include <array>
#include <fstream>
#include <stdexcept>

#include <openssl/crypto.h>

#include <iotcloud/drivers/http/http_driver.h>
#include <iotcloud/drivers/property_reader.h>
#include <iotcloud/drivers/stream/address.h>

namespace iotcloud::drivers::http {

namespace {

constexpr std::size_t shortest_token = 16;

/// Whether it can be the value of a field in a request's head.
bool is_field(const std::string& text) {
  constexpr std::size_t longest = 1000;
  return text.size() <= longest && std::all_of(text.begin(), text.end(), [](char c) {
           return static_cast<unsigned char>(c) >= ' ' && c != '\x7f';
         });
}

std::string token_in(const std::string& property, const std::string& file) {
  if (file.empty()) return "";
  std::ifstream in(file);
  std::string token;
  std::getline(in, token);
  if (token.size() >= shortest_token && is_field(token)) return token;
  throw std::invalid_argument("property \"" + property + "\": the first line of \"" + file +
                              "\" is no token of at least 16 characters, or cannot be read (openssl rand -hex 32)");
}

bool is_loopback(const std::string& address) {
  return address == "localhost" || address.starts_with("127.") || address == "::1";
}

bool is_same(std::string_view a, std::string_view b) {
  return a.size() == b.size() && CRYPTO_memcmp(a.data(), b.data(), a.size()) == 0;
}

/// Whether it can stand in the first line of a request.
bool is_target(const std::string& text) {
  return text.starts_with('/') && std::all_of(text.begin(), text.end(), [](char c) { return c > ' ' && c < '\x7f'; });
}

/// A query without the sender's token, which is nobody else's.
std::string without_token(const std::string& query) {
  std::string rest;
  for (std::size_t at = 0; at <= query.size();) {
    const std::size_t end = std::min(query.find('&', at), query.size());
    const std::string part = query.substr(at, end - at);
    if (!part.starts_with("token=") && !part.empty()) rest += (rest.empty() ? "" : "&") + part;
    at = end + 1;
  }
  return rest;
}

Call read_url(const std::string& url) {
  Call call;
  call.tls = url.starts_with("https://");
  const auto begin = url.find("://");
  const std::string rest = begin == std::string::npos ? "" : url.substr(begin + 3);
  const auto slash = std::min(rest.find('/'), rest.size());
  std::string address = rest.substr(0, slash);
  call.target = slash == rest.size() ? "/" : rest.substr(slash);
  if ((!call.tls && !url.starts_with("http://")) || address.empty() || !is_target("/" + address + call.target)) {
    throw std::invalid_argument("property \"call_url\" is \"" + url +
                                "\"; it takes http://HOST[:80]/PATH or https://HOST[:443]/PATH");
  }
  if (address.ends_with(']') || address.find(':') == std::string::npos) address += call.tls ? ":443" : ":80";
  const stream::HostPort parts = stream::split_address("call_url", address);
  call.host = parts.host;
  call.port = std::to_string(parts.port);
  return call;
}

}  // namespace

HttpDriver::Options HttpDriver::read_options(const PropertyMap& properties) {
  PropertyReader reader(properties);
  Options options;
  const std::string listen = reader.text("listen", ""), url = reader.text("call_url", "");
  options.serves = !listen.empty();
  options.calls = !url.empty();
  if (!options.serves && !options.calls)
    throw std::invalid_argument("give one of the properties \"listen\" (webhooks) and \"call_url\" (calls), or both");
  if (options.calls) options.call = read_url(url);
  options.path = reader.text("path", "/");
  options.token_file = reader.text("token_file", "");
  options.call_token_file = reader.text("call_token_file", "");
  options.broker = reader.text("broker", "");
  options.calls_waiting = static_cast<std::size_t>(reader.integer("calls_waiting", 100, 1, 1'000'000));
  options.call.most_bytes = options.server.most_bytes = stream::read_most_bytes(reader);
  options.call.method = reader.text("call_method", "POST");
  options.call.content_type = reader.text("call_content_type", "application/json");
  if (!is_field(options.call.content_type)) {
    throw std::invalid_argument("property \"call_content_type\" is \"" + options.call.content_type +
                                "\"; it takes a type such as text/plain");
  }
  options.call.ca = reader.text("ca", "");
  options.call.limit = std::chrono::milliseconds(reader.integer("call_timeout_ms", 10'000, 10, 600'000));
  options.server.certificate = reader.text("certificate", "");
  options.server.key = reader.text("key", "");
  options.server.connections = static_cast<std::size_t>(reader.integer("connections", 64, 1, 10'000));
  if (options.server.certificate.empty() != options.server.key.empty())
    throw std::invalid_argument("give both of the properties certificate and key, or none");
  const bool plain = reader.flag("plain", false);
  if (!options.serves) return options;
  static_cast<void>(stream::read_address("listen", listen));  // refuses a name
  const stream::HostPort parts = stream::split_address("listen", listen);
  options.server.address = parts.host == "localhost" ? "127.0.0.1" : parts.host;
  options.server.port = parts.port;
  if (is_loopback(options.server.address)) return options;
  if (options.token_file.empty())
    throw std::invalid_argument("other machines reach " + listen + ": give the property token_file");
  if (options.server.certificate.empty() && !plain) {
    throw std::invalid_argument(
        "other machines reach " + listen +
        ": give the properties certificate and key, or plain=true if the token may be read on the way");
  }
  return options;
}

std::vector<ChannelSpec> HttpDriver::channels(const PropertyMap& properties) {
  options_ = read_options(properties);
  std::vector<ChannelSpec> specs;
  ChannelSpec spec;
  spec.broker = options_.broker;
  if (options_.serves) {
    spec.name = received_channel;
    specs.push_back(spec);
  }
  if (options_.calls) {
    spec.name = answers_channel;
    spec.when_full = WhenFull::keep_newest;  // nobody need read them
    specs.push_back(spec);
    ChannelSpec calls;
    calls.name = call_channel;
    calls.direction = Direction::in;
    calls.broker = options_.broker;
    specs.push_back(calls);
  }
  return specs;
}

void HttpDriver::open(DriverContext& context) {
  context_ = &context;
  token_ = token_in("token_file", options_.token_file);
  call_token_ = token_in("call_token_file", options_.call_token_file);
  lost_.emplace(context);
  end_ = std::make_unique<HttpEnd>();
  if (options_.serves) {
    const std::string address = end_->serve(options_.server, [this](const Webhook& webhook) { return take(webhook); });
    context.update_metadata({{"listen", address}});
  }
  if (options_.calls) state_.emplace(context);
}

void HttpDriver::close() {
  end_.reset();
}

bool HttpDriver::shows_token(const Webhook& webhook) const {
  constexpr std::string_view scheme = "Bearer ";
  if (webhook.authorization.starts_with(scheme) &&
      is_same(std::string_view(webhook.authorization).substr(scheme.size()), token_))
    return true;
  constexpr std::string_view name = "token=";
  const std::string_view query = webhook.query;
  for (std::size_t at = 0; at < query.size();) {
    const std::size_t end = std::min(query.find('&', at), query.size());
    const std::string_view part = query.substr(at, end - at);
    if (part.starts_with(name) && is_same(part.substr(name.size()), token_)) return true;
    at = end + 1;
  }
  return false;
}

WebhookAnswer HttpDriver::take(const Webhook& webhook) {
  if (!token_.empty() && !shows_token(webhook)) return {401, "Show the token: Authorization: Bearer TOKEN\n"};
  if (!webhook.path.starts_with(options_.path)) return {404, "There is nothing here.\n"};
  if (webhook.method != "POST" && webhook.method != "PUT" && webhook.method != "PATCH")
    return {405, "POST, PUT or PATCH it.\n"};
  if (!active_) return {503, "The driver's instance is not active.\n", 10};
  Message message;
  message.payload = Payload::copy(webhook.body);
  message.properties.set("method", webhook.method);
  message.properties.set("path", webhook.path);
  message.properties.set("peer", webhook.peer);
  if (!webhook.content_type.empty()) message.properties.set("content_type", webhook.content_type);
  if (const std::string query = without_token(webhook.query); !query.empty()) message.properties.set("query", query);
  if (context_->publish(received_channel, std::move(message)) == PublishStatus::accepted) return {};
  return {503, "The channel is full.\n", 1};
}

void HttpDriver::on_message(std::string_view channel, Message message) {
  if (channel != call_channel) return;
  if (const std::string problem = queue(message); !problem.empty()) lost_->warn("a call is lost: " + problem);
}

std::string HttpDriver::queue(const Message& message) {
  if (waiting_.size() > options_.calls_waiting) return "others wait (calls_waiting)";
  Call call = options_.call;
  if (const std::string* path = message.properties.find("path")) {
    if (!is_target(*path)) return "\"" + *path + "\" is no path: it begins with / and has no blanks";
    if (call.target.ends_with('/')) call.target.pop_back();
    call.target += *path;
  }
  if (const std::string* method = message.properties.find("method")) {
    constexpr std::array known{"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"};
    if (std::find(known.begin(), known.end(), *method) == known.end())
      return "\"" + *method + "\" is no method that it knows";
    call.method = *method;
  }
  if (const std::string* type = message.properties.find("content_type")) {
    if (!is_field(*type)) return "its content_type has more than 1000 bytes, or the end of a line in it";
    call.content_type = *type;
  }
  if (!call_token_.empty()) call.authorization = "Bearer " + call_token_;
  call.body = message.payload.text();
  waiting_.emplace_back(std::move(call), message.time_ms);
  if (waiting_.size() == 1) call_next();
  return "";
}

void HttpDriver::call_next() {
  end_->call(waiting_.front().first,
             [this](CallAnswer answer) { context_->post([this, answer = std::move(answer)] { answered(answer); }); });
}

void HttpDriver::answered(const CallAnswer& answer) {
  const auto [call, time_ms] = std::move(waiting_.front());
  waiting_.pop_front();
  Message message;
  message.payload = Payload::copy(answer.body);
  message.time_ms = time_ms;
  message.properties.set("status", std::to_string(answer.status));
  message.properties.set("path", call.target);
  if (!answer.content_type.empty()) message.properties.set("content_type", answer.content_type);
  if (answer.problem.empty()) {
    state_->connected();
  } else {
    message.properties.set("problem", answer.problem);
    state_->away(answer.problem);
  }
  if (context_->publish(answers_channel, std::move(message)) == PublishStatus::would_block)
    lost_->warn("the answer to a call is lost: the channel is full");
  if (!waiting_.empty()) call_next();
}

}  // namespace iotcloud::drivers::http
