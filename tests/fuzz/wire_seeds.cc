#include <string>
#include <vector>

#include "iotcloud/discovery/records.h"
#include "iotcloud/gateway/host/protocol.h"
#include "iotcloud/processes/starter_protocol.h"
#include "iotcloud/security/audit_chain.h"
#include "iotcloud/tests/fuzz/seeds.h"
#include "iotcloud/topology/tuple_codec.h"

namespace iotcloud::fuzz {

namespace {

namespace host = gateway::protocol;

std::string header(const std::string& name, const std::string& value) {
  return std::string(1, static_cast<char>(name.size())) + name + std::string(1, static_cast<char>(value.size())) +
         value;
}

SeedsOfTarget host_protocol() {
  host::HostReport hello;
  hello.kind = host::HostReport::Kind::hello;
  hello.order.plugin = "turtle.so";
  hello.order.gateway = discovery::GatewayId("gw");
  host::HostReport refused;
  refused.kind = host::HostReport::Kind::refused;
  refused.reason = "no";
  host::HostReport passed;
  passed.kind = host::HostReport::Kind::pass;
  passed.passed.number = 3;
  host::HostCommand create;
  create.kind = host::HostCommand::Kind::create;
  create.spec.emplace();
  create.spec->order.instance = discovery::InstanceId("01");
  create.spec->order.plugin = "turtle.so";
  host::HostCommand stop;
  stop.kind = host::HostCommand::Kind::shutdown;
  stop.number = 500;
  return {{"reports", '\x21' + encode(hello) + encode(refused) + encode(passed) + encode(host::HostReport{})},
          {"commands", '\x20' + encode(create) + encode(stop) + encode(host::HostCommand{})}};
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

std::string tuple() {
  topology::TupleRecord record;
  record.component = "decode";
  record.source_task = 2;
  record.ids = {1, 2};
  record.values = topology::Values(std::int64_t{-5}, 0.5, std::string("robot"), true);
  std::vector<std::byte> bytes;
  topology::encode_tuple(record, bytes);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
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
  const std::string removal = encode(discovery::OrderRemoval{order.instance, 7, order.given_ms});
  const std::string foreign = R"(,"signature":")" + std::string(128, 'a') + "\"}";
  return {{"stored", '\0' + encode(order)},
          {"stored_foreign", '\0' + removal.substr(0, removal.size() - 1) + foreign},
          {"stored_no_hex",
           '\0' + removal.substr(0, removal.size() - 1) + R"(,"signature":")" + std::string(128, '+') + "\"}"},
          {"order", "\1\7" + encode(order)},
          {"removal", "\1\x20" + removal},
          {"topology_order", "\1\x01" + encode(topology)},
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

}  // namespace

void add_wire_seeds(Seeds& seeds) {
  const std::string hash(64, 'a');
  seeds["host_protocol"] = host_protocol();
  seeds["starter_protocol"] = starter_protocol();
  seeds["kafka_headers"]["ours"] = header("sensorID", "01") + header("siteID", "gw") + header("time", "1700000000000") +
                                   header("x-iotcloud-expires", "9") + header("x-iotcloud-resent", "1");
  seeds["kafka_headers"]["others"] = header("traceparent", "00-1") + header("", "") + std::string("\x01n\xff", 3);
  seeds["signed_orders"] = signed_orders();
  seeds["json_payload"] = json_payloads();
  seeds["tuple"]["values"] = tuple();
  seeds["http"] = {{"page", "GET /page?a=1&b=%20x+y&c HTTP/1.1\r\nHost: lab1\r\n\r\n"},
                   {"two", "GET /page HTTP/1.1\r\nHost: lab1\r\n\r\nHEAD /page?%zz HTTP/1.0\r\n\r\n"},
                   {"token", "GET /metrics HTTP/1.1\r\nAuthorization: Bearer anna.00\r\n\r\n"},
                   {"body", "POST /page HTTP/1.1\r\nContent-Length: 3\r\nTransfer-Encoding: chunked\r\n\r\nabc"}};
  seeds["signed_text"] = {
      {"signature", '\0' + std::string("iotcloud-plugin turtle 7\n") + std::string(64, 's')},
      {"bare", '\0' + std::string(64, 's')},
      {"line", '\1' + std::string(R"({"number":2,"previous":")") + hash + R"(","time":""})"},
      {"head", '\2' + to_string(security::AuditHead{7, hash})},
  };
}

}  // namespace iotcloud::fuzz
