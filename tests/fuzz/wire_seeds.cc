#include <string>
#include <vector>

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

}  // namespace

void add_wire_seeds(Seeds& seeds) {
  const std::string hash(64, 'a');
  seeds["host_protocol"] = host_protocol();
  seeds["starter_protocol"] = starter_protocol();
  seeds["kafka_headers"]["ours"] = header("sensorID", "01") + header("siteID", "gw") + header("time", "1700000000000") +
                                   header("x-iotcloud-expires", "9") + header("x-iotcloud-resent", "1");
  seeds["kafka_headers"]["others"] = header("traceparent", "00-1") + header("", "") + std::string("\x01n\xff", 3);
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
