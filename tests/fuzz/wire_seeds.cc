#include <chrono>
#include <cstring>
#include <limits>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>

#include "iotcloud/discovery/freeze.h"
#include "iotcloud/discovery/records.h"
#include "iotcloud/discovery/submissions.h"
#include "iotcloud/gateway/host/protocol.h"
#include "iotcloud/processes/connector_request.h"
#include "iotcloud/processes/starter_protocol.h"
#include "iotcloud/security/audit_chain.h"
#include "iotcloud/tests/fuzz/seeds.h"
#include "iotcloud/topology/pool/worker_protocol.h"
#include "iotcloud/topology/storm/value_format.h"

namespace iotcloud::fuzz {

namespace {

namespace host = gateway::protocol;

std::string header(const std::string& name, const std::string& value) {
  return std::string(1, static_cast<char>(name.size())) + name + std::string(1, static_cast<char>(value.size())) +
         value;
}

SeedsOfTarget host_protocol() {
  host::HostHello hello;
  hello.order.plugin = "turtle.so";
  hello.order.gateway = discovery::GatewayId("gw");
  host::PassMessage passed;
  passed.passed.number = 3;
  host::CreateInstance create;
  create.spec.order.instance = discovery::InstanceId("01");
  create.spec.order.plugin = "turtle.so";
  host::DeliverMessage deliver;
  deliver.passed.topic = "gw.turtle.control";
  deliver.passed.message.driver_id = "01";
  deliver.passed.message.properties.set("unit", std::string("\0\xff", 2));
  deliver.passed.message.payload = brokers::Payload::copy("on");
  host::AskAboutChannel ask;
  ask.number = 7;
  ask.question.look.instance = discovery::InstanceId("01");
  ask.question.message = deliver.passed.message;
  const host::HostCommand answer = host::AnswerMessage{7, gateway::PassAnswer::nowhere};
  const host::HostReport answered = host::AnswerMessage{7, gateway::PassAnswer::comes};
  host::Pong pong;
  pong.stalls.emplace_back();
  pong.brokers.emplace_back();
  host::HostSamples metrics;
  for (const auto kind : {config::Sample::Kind::gauge, config::Sample::Kind::histogram}) {
    auto& sample = metrics.samples.emplace_back();
    sample.name = "iotcloud_x";
    sample.labels = {{"a", "b"}};
    sample.kind = kind;
  }
  host::ChannelAnswer told;
  told.look.messages.emplace_back().payload = "on";
  host::HostHello running;
  running.instances.emplace_back().spec = create.spec;
  const auto& instance = create.spec.order.instance;
  return {
      {"proof", '\x20' + encode(host::ProveGateway{std::string(64, 'a')}) + encode(host::Ping{})},
      {"messages", '\x20' + encode(deliver) + encode(ask) + encode(answer)},
      {"state", '\x21' + encode(running) + encode(pong) + encode(told)},
      {"metrics", '\x21' + encode(metrics)},
      {"reports", '\x21' + encode(hello) + encode(host::PluginRefused{"no"}) + encode(passed) + encode(host::Pong{})},
      {"changes", '\x21' + encode(host::StatusChange{}) + encode(answered)},
      {"commands",
       '\x20' + encode(create) + encode(host::ShutDown{std::chrono::milliseconds(500)}) + encode(host::Ping{})},
      {"instances", '\x20' + encode(host::ActivateInstance{instance}) + encode(host::DeactivateInstance{instance}) +
                        encode(host::RemoveInstance{instance, gateway::Removal::undeployed}) +
                        encode(host::RenewLeases{std::chrono::nanoseconds(7)}) + encode(host::AskForSamples{})}};
}

SeedsOfTarget starter_protocol() {
  using processes::StarterAnswer;
  using processes::StarterRequest;
  const StarterRequest run{StarterRequest::Kind::run, {"iotcloud-driver-host", "--plugin", "a.so"}, {"LANG=C", "TZ="}};
  const StarterRequest kill{StarterRequest::Kind::kill, {}, {}};
  return {{"run", '\x20' + encode(run)},
          {"kill", '\x20' + encode(kill) + encode(kill)},
          {"answers", '\x21' + encode(StarterAnswer{StarterAnswer::Kind::started, 4711, {}}) +
                          encode(StarterAnswer{StarterAnswer::Kind::ended, 9, {}})},
          {"refusals", '\x21' + encode(StarterAnswer{StarterAnswer::Kind::failed, 0, "no"}) +
                           encode(StarterAnswer{StarterAnswer::Kind::killed, 0, {}})}};
}

template <typename Address>
processes::ConnectRequest connect_to(const Address& address) {
  processes::ConnectRequest request;
  std::memcpy(&request.address, &address, sizeof address);
  request.size = sizeof address;
  return request;
}

/// The first byte says how many descriptors come with the rest, or that it is no request (connector_request_fuzzer.cc).
SeedsOfTarget connector_requests() {
  constexpr std::uint16_t port = 554;
  sockaddr_in ip4{};
  ip4.sin_family = AF_INET;
  ip4.sin_port = htons(port);
  ip4.sin_addr.s_addr = htonl(0x0A000007);
  sockaddr_in6 ip6{};
  ip6.sin6_family = AF_INET6;
  ip6.sin6_port = htons(port);
  ip6.sin6_addr = in6addr_loopback;
  ip6.sin6_scope_id = 1;
  sockaddr_un local{};
  local.sun_family = AF_UNIX;
  return {{"ip4", '\2' + encode(connect_to(ip4))},
          {"ip6", '\2' + encode(connect_to(ip6))},
          {"local", '\2' + encode(connect_to(local))},
          {"find", '\1' + encode(processes::FindRequest{"camera", true})},
          {"find_full", '\1' + encode(processes::FindRequest{"Camera.", false})},
          {"places", "\4camera-1:554, Camera.Lab.:80 10.0.0.7:65535,[2001:db8::7]:1"}};
}

SeedsOfTarget worker_protocol() {
  using topology::pooled::PoolCommand;
  using topology::pooled::WorkerReport;
  return {{"commands", '\x20' + encode(PoolCommand{}) + encode(PoolCommand{true})},
          {"reports", '\x21' + encode(WorkerReport{}) + encode(WorkerReport{true, "lab1-4711", "count", 2, 61'000})}};
}

/// The first byte says what is settled after that (kafka_progress_fuzzer.cc).
SeedsOfTarget kafka_progress() {
  const auto committed = [](char first, std::int64_t offset, const std::string& text) {
    std::string bytes(1 + sizeof offset, first);
    std::memcpy(bytes.data() + 1, &offset, sizeof offset);
    return bytes + text;
  };
  constexpr auto last = std::numeric_limits<std::int64_t>::max();
  return {{"on", committed('\x0a', 5, "iotcloud1 on 7 2,5-6,")},
          {"ended", committed('\xa5', 0, "iotcloud1 end 0 ")},
          {"none", committed('\xff', -1, "")},
          {"last", committed('\0', last, "iotcloud1 end 9 0-1152921504606846976,1")},
          {"foreign", committed('\1', 1 << 20, "iotcloud2 end 1 2,")}};
}

/// The first byte chooses whether the target signs the rest (signed_orders_fuzzer.cc), the second what it changes then.
SeedsOfTarget signed_orders() {
  discovery::OrderRecord order;
  order.instance = discovery::InstanceId("01");
  order.plugin = "turtle.so";
  order.given_ms = 1'700'000'000'000;
  discovery::TopologyOrder topology;
  topology.revision = 3;
  topology.parallelism = {{"decode", 2}};
  discovery::Submission submission;
  submission.name = discovery::TopologyName("mirror");
  submission.workers = 2;
  submission.version.number = 3;
  submission.given_ms = order.given_ms;
  discovery::DrainRecord drain;
  drain.epoch = 7;
  const std::string removal = encode(discovery::OrderRemoval{order.instance, 7, order.given_ms});
  const std::string foreign = R"(,"signature":")" + std::string(128, 'a') + "\"}";
  return {{"stored", '\0' + encode(order)},
          {"stored_foreign", '\0' + removal.substr(0, removal.size() - 1) + foreign},
          {"stored_no_hex",
           '\0' + removal.substr(0, removal.size() - 1) + R"(,"signature":")" + std::string(128, '+') + "\"}"},
          {"order", "\1\7" + encode(order)},
          {"removal", "\1\x20" + removal},
          {"topology_order", "\1\x01" + encode(topology)},
          {"submission", "\1\x11" + encode(submission)},
          {"stored_submission", '\0' + encode(submission)},
          {"adoption", "\1\x02" + encode(discovery::Adoption{"5f0e", 7})},
          {"drain", "\1\x03" + encode(drain)},
          {"signed_twice", "\1\x40" + removal.substr(0, removal.size() - 1) + foreign},
          {"no_keys", std::string("\1\0", 2) + "{}"}};
}

/// The first byte chooses who reads the rest (json_payload_fuzzer.cc).
SeedsOfTarget json_payloads() {
  const std::string deep = std::string(70, '[') + std::string(70, ']');
  return {{"values", '\0' + std::string(R"({"a":-5,"b":0.5e3,"c":"text \u00e9","d":true,"e":null})")},
          {"within", '\0' + std::string(R"({"a":{"b":[1,2]},"c":[],"other":18446744073709551615})")},
          {"too_large", '\0' + std::string(R"({"a":18446744073709551615})")},
          {"twice", '\0' + std::string(R"({"a":1,"a":"2","b":-9223372036854775808,"c":1e-320,"d":-0.0})")},
          {"deep", '\0' + std::string(R"({"a":)") + deep + "}"},
          {"no_object", '\0' + std::string("[1]")},
          {"command", '\1' + std::string(R"({"linear":{"x":0.2,"y":0,"z":0},"angular":{"x":0,"y":0,"z":-1e1}})")},
          {"command_wrong", '\1' + std::string(R"({"linear":{"x":"0.2"},"angular":7})")},
          {"command_deep", '\1' + std::string(2'000, '[')}};
}

/// The first byte says what comes with the values (storm_values_fuzzer.cc).
SeedsOfTarget storm_values() {
  using topology::Payload;
  using topology::Values;
  namespace storm = topology::storm;
  const auto bytes = [](char first, const Values& values, storm::JavaValues elsewhere = {}) {
    std::vector<std::byte> encoded(storm::encoded_size(values.all(), elsewhere));
    storm::encode_values(values.all(), encoded.data(), elsewhere);
    return first + std::string(reinterpret_cast<const char*>(encoded.data()), encoded.size());
  };
  const std::vector<std::optional<storm::JavaValue>> apart{storm::JavaValue{}, std::nullopt, storm::JavaValue{}};
  const auto large = Payload::copy(std::string("large"));
  return {
      {"kinds", bytes('\0', Values(std::monostate(), true, false, -1, 2.5, "z\xC3\xA4hlt", large))},
      {"none", bytes('\0', Values())},
      {"birth", bytes('\1', Values("a", std::int64_t{1'700'000'000'000}))},
      {"arrays", bytes('\x0a', Values(large, "between", large), apart)},
      {"arrays_and_birth", bytes('\x0b', Values(large, -1, large, std::numeric_limits<std::int64_t>::min()), apart)},
      {"of_tuple", std::string("\0\1\0\0\0\7\3\0\0\0\2\0\0\0", 14)}};
}

/// What a worker says of its tasks (topology/worker), as older ones and no worker say it.
SeedsOfTarget worker_pages() {
  const std::string component = R"({"id":"in","kind":"spout","parallelism":2147483647,"tasks":1})";
  const std::string latency = R"({"count":7,"p50_us":1.5,"p99_us":1e300,"max_us":0})";
  const std::string task = R"({"component":"in","task":0,"emitted":1,"transferred":18446744073709551615,"executed":1,)"
                           R"("acked":1,"failed":0,"timed_out":0,"late":0,"superseded":0,"errors":0,"queue_depth":0,)"
                           R"("pending":0,"capacity":0.5,"oldest_s":3.5,"last_error":"","execute":)" +
                           latency + R"(,"process":)" + latency + R"(,"complete":)" + latency + "}";
  const std::string head = R"({"worker":"w1","components":[)" + component;
  return {{"whole", head + R"(],"tasks":[)" + task + R"(],"brokers":[{"broker":"b","state":"up"}],"troubles":[]})"},
          {"twice", head + "," + component + R"(],"tasks":[)" + task + "," + task + "]}"},
          {"other_types", head + R"(],"tasks":{"a":1},"brokers":"none","troubles":[1,[2]]})"},
          {"deep", R"({"worker":"w1","components":)" + std::string(20'000, '[') + std::string(20'000, ']') + "}"},
          {"no_object", "[]"}};
}

}  // namespace

void add_wire_seeds(Seeds& seeds) {
  const std::string hash(64, 'a');
  seeds["host_protocol"] = host_protocol();
  seeds["starter_protocol"] = starter_protocol();
  seeds["connector_request"] = connector_requests();
  seeds["worker_protocol"] = worker_protocol();
  seeds["storm_values"] = storm_values();
  seeds["kafka_headers"]["ours"] = header("sensorID", "01") + header("siteID", "gw") + header("time", "1700000000000") +
                                   header("x-iotcloud-expires", "9") + header("x-iotcloud-resent", "1");
  seeds["kafka_headers"]["twice"] = header("sensorID", "01") + header("sensorID", "02") + header("time", "-1");
  seeds["kafka_headers"]["no_numbers"] =
      header("time", "99999999999999999999") + header("x-iotcloud-expires", "soon") + header("x-iotcloud-resent", "");
  seeds["kafka_headers"]["without_values"] = std::string("\x08sensorID\xff\x06siteID\xff\x04time\xff", 24);
  for (int i = 0; i < 70; ++i) seeds["kafka_headers"]["many"] += header("n" + std::to_string(i), "v");
  seeds["kafka_headers"]["others"] = header("traceparent", "00-1") + header("", "") + std::string("\x01n\xff", 3);
  seeds["kafka_progress"] = kafka_progress();
  seeds["signed_orders"] = signed_orders();
  seeds["json_payload"] = json_payloads();
  seeds["http"] = {
      {"page", "GET /page?a=1&b=%20x+y&c HTTP/1.1\r\nHost: lab1\r\n\r\n"},
      {"two", "GET /page HTTP/1.1\r\nHost: lab1\r\n\r\nHEAD /page?%zz HTTP/1.0\r\n\r\n"},
      {"pipelined", "GET /page HTTP/1.1\r\nAuthorization: Bearer anna.00\r\n\r\nGET /page HTTP/1.1\r\n\r\n"},
      {"basic", "GET /page HTTP/1.1\r\nAuthorization: Basic YTpi\r\nAuthorization: Bearer\r\n\r\n"},
      {"absolute", "GET http://lab1/page?a=%00%ff HTTP/1.1\r\nConnection: keep-alive, Upgrade\r\n\r\n"},
      {"long_header", "GET /page HTTP/1.1\r\nX: " + std::string(9'000, 'x') + "\r\n\r\n"},
      {"token", "GET /metrics HTTP/1.1\r\nAuthorization: Bearer anna.00\r\n\r\n"},
      {"body", "POST /page HTTP/1.1\r\nContent-Length: 3\r\nTransfer-Encoding: chunked\r\n\r\nabc"}};
  seeds["http_client"] = {
      {"page", "HTTP/1.1 200 OK\r\nContent-Type: text/plain\r\nContent-Length: 3\r\n\r\nok\n"},
      {"until_end", "HTTP/1.0 200 OK\r\n\r\nok\n"},
      {"chunked", "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n3;a=b\r\nok\n\r\n0\r\nTrailer: 1\r\n\r\n"},
      {"refused", "HTTP/1.1 401 Unauthorized\r\nWWW-Authenticate: Bearer\r\nContent-Length: 2\r\n\r\nno"},
      {"continue", "HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n"},
      {"too_large", "HTTP/1.1 200 OK\r\nContent-Length: 18446744073709551615\r\n\r\nx"},
      {"moved", "HTTP/1.1 302 Found\r\nLocation: http://169.254.169.254/\r\nContent-Length: 0\r\n\r\n"}};
  seeds["worker_page"] = worker_pages();
  seeds["signed_text"] = {
      {"signature", '\0' + std::string("iotcloud-plugin turtle 7\n") + std::string(64, 's')},
      {"bare", '\0' + std::string(64, 's')},
      {"line", '\1' + std::string(R"({"number":2,"previous":")") + hash + R"(","time":""})"},
      {"head", '\2' + to_string(security::AuditHead{7, hash})},
  };
}

}  // namespace iotcloud::fuzz
