// channel list, echo, hz, bw and publish: what the command line has from a driver host, by way of gateway and master.
#include <mutex>

#include <gmock/gmock.h>
#include <thrift/TProcessor.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include "iotcloud/master/TMasterAPIService.h"
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/master/cli/cli_fixture.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::master::test {
namespace {

using namespace std::string_literals;
using discovery::wire::TChannelLook;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// A gateway whose driver hosts answer what the test says: `moves` messages more each time that somebody looks. Thread
/// safe.
class PlayedChannels final : public gateway::wire::TSensorSiteServiceNull {
 public:
  explicit PlayedChannels(std::string gateway = "lab1") : gateway_(std::move(gateway)) {}
  void ping(gateway::wire::TPing& answer) override { answer.__set_gateway(gateway_); }
  void lookAtChannel(TChannelLook& look, const discovery::wire::TLookRequest& request) override {
    const std::lock_guard lock(mutex_);
    looks_.push_back(request);
    look.__set_state(state_);
    if (request.last) return;
    if (!request.channel.empty() && request.channel != "readings") {
      look.__set_problem("instance " + request.instance + " has no channel \"" + request.channel +
                         "\"; it has \"readings\" (out)");
      return;
    }
    discovery::wire::TChannelState channel;
    channel.__set_name("readings");
    channel.__set_direction(discovery::wire::TDirection::OUT);
    channel.__set_broker("rabbitmq");
    channel.__set_brokerState("away");
    channel.__set_brokerProblem("connection refused");
    channel.__set_waiting(3);
    channel.__set_oldestMs(1500);
    look.__set_channels({channel});
    if (request.channel.empty()) return;
    elapsed_us_ += 1'000'000;
    look.__set_elapsedUs(elapsed_us_);
    if (looks_.size() == 1) return;  // the first question begins the look
    for (const auto& payload : payloads_) {
      ++count_;
      bytes_ += static_cast<std::int64_t>(payload.size());
      if (request.most == 0) continue;
      auto& seen = look.messages.emplace_back();
      seen.__set_number(count_);
      seen.__set_seenMs(1'000'000'000'000);
      seen.__set_payload(payload);
      seen.__set_size(static_cast<std::int64_t>(payload.size()));
      seen.__set_properties({{"unit", "C"}});
    }
    look.__set_count(count_);
    look.__set_bytes(bytes_);
    look.__set_shortestUs(19'000);
    look.__set_longestUs(21'000);
    look.__set_smallest(4);
    look.__set_largest(1200);
    if (stops_) state_ = "inactive";
  }
  void handMessage(TChannelLook& look, const discovery::wire::THandedMessage& message) override {
    const std::lock_guard lock(mutex_);
    handed_.push_back(message);
    look.__set_problem(refusal_);
  }

  void carry(std::vector<std::string> payloads) {
    const std::lock_guard lock(mutex_);
    payloads_ = std::move(payloads);
  }
  void stop_after_the_next() {
    const std::lock_guard lock(mutex_);
    stops_ = true;
  }
  void refuse(const std::string& why) {
    const std::lock_guard lock(mutex_);
    refusal_ = why;
  }
  std::vector<discovery::wire::TLookRequest> looks() {
    const std::lock_guard lock(mutex_);
    return looks_;
  }
  std::vector<discovery::wire::THandedMessage> handed() {
    const std::lock_guard lock(mutex_);
    return handed_;
  }

 private:
  const std::string gateway_;
  std::mutex mutex_;  ///< guards all that follows
  std::vector<std::string> payloads_;
  std::string state_ = "active", refusal_;
  bool stops_ = false;
  std::int64_t count_ = 0, bytes_ = 0, elapsed_us_ = 0;
  std::vector<discovery::wire::TLookRequest> looks_;
  std::vector<discovery::wire::THandedMessage> handed_;
};

class CliChannels : public Cli {
 protected:
  CliChannels() {
    serve(std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(site_));
    id_ = deploy("lab1");
  }
  void serve(const std::shared_ptr<apache::thrift::TProcessor>& processor) {
    service_.reset();
    service_.emplace(rpc::ThriftServerOptions{}, [processor](const auto&) { return processor; });
    show("lab1"_gateway, service_->port());
  }
  /// From now on the gateway's record says that its service is there.
  void show(const discovery::GatewayId& gateway, int port) const {
    const discovery::Paths paths;
    auto registry = open_registry(url);
    auto record = discovery::decode_gateway(registry->get(paths.gateway(gateway))->data, gateway.str());
    record.host = "127.0.0.1";
    record.port = port;
    discovery::put(*registry, paths.gateway(gateway), encode(record));
  }

  FakeGateway lab1_{url, "lab1"};
  const std::shared_ptr<PlayedChannels> site_ = std::make_shared<PlayedChannels>();
  std::optional<rpc::ThriftServer> service_;
  std::string id_;
};

TEST_F(CliChannels, ListShowsAllChannelsAndOfOneInstanceWhatWaitsInThem) {
  EXPECT_THAT(run({"channel", "list"}).out, AllOf(HasSubstr("CHANNEL"), HasSubstr(id_), HasSubstr("exclusive")));
  EXPECT_EQ(run_json({"channel", "list"})[0]["instance"], id_);
  const auto one = run({"channel", "list", id_.substr(0, 8)});
  EXPECT_THAT(one.out, AllOf(HasSubstr("readings"), HasSubstr("out"), HasSubstr("3"), HasSubstr("1.5 s"),
                             HasSubstr("away: connection refused")))
      << one.err;
  const auto json = run_json({"channel", "list", id_});
  EXPECT_EQ(json[0]["waiting"], 3);
  EXPECT_EQ(json[0]["oldest_ms"], 1500);
}

TEST_F(CliChannels, EchoShowsMessagesAndEndsAfterAsManyAsWereAskedFor) {
  site_->carry({"21.5", R"({"t": 1})", "\x01\x02"s});
  const auto done = run({"channel", "echo", id_, "readings", "-n", "3", "--properties"});
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_THAT(done.out, AllOf(HasSubstr(" 21.5 unit=C\n"), HasSubstr(R"( {"t":1} unit=C)"), HasSubstr("<2 B: 01 02>")));
  EXPECT_TRUE(site_->looks().back().last) << "it says that it has ended";
  const auto once = run({"channel", "echo", id_, "readings", "--once", "--format", "hex", "-o", "json"});
  const auto json = nlohmann::json::parse(once.out);
  EXPECT_EQ(json["payload"], "32312e35");
  EXPECT_EQ(json["format"], "hex");
}

/// SECURITY.md: the thief of lab2 makes a record with the id of an instance on lab1.
TEST_F(CliChannels, OfAnInstanceMayBeThoseOfAThiefWhoMadeARecordWithItsId) {
  site_->carry({"21.5"});
  EXPECT_THAT(run({"channel", "echo", id_, "readings", "--once"}).out, HasSubstr("21.5"))
      << "the instance's own gateway is asked";
  const FakeGateway stolen(url, "lab2");
  const auto thief = std::make_shared<PlayedChannels>("lab2");
  thief->carry({"forged"});
  const rpc::ThriftServer service(
      rpc::ThriftServerOptions{},
      [p = std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(thief)](const auto&) { return p; });
  show("lab2"_gateway, service.port());
  discovery::DriverRecord forged;
  forged.name = "aaa"_driver;
  forged.instance = discovery::InstanceId(id_);
  forged.gateway = "lab2"_gateway;
  forged.state = discovery::DriverState::active;
  discovery::put(*open_registry(url), discovery::Paths().instance(forged.name, forged.instance), encode(forged));
  EXPECT_TRUE(eventually([&] {
    return run({"channel", "echo", id_, "readings", "--once"}).out.find("forged") != std::string::npos;
  })) << "the thief's messages";
  EXPECT_EQ(run({"channel", "publish", id_, "control", "on"}).status, 0);
  EXPECT_EQ(thief->handed().size(), 1u) << "what a person sends goes to the thief";
  EXPECT_EQ(site_->handed().size(), 0u);
}

TEST_F(CliChannels, AChannelThatIsNotThereIsAnsweredWithThoseThatAre) {
  const auto done = run({"channel", "echo", id_, "temprature"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("has no channel \"temprature\"; it has \"readings\" (out)"));
}

TEST_F(CliChannels, WhenTheInstanceStopsTheCommandSaysSo) {
  site_->carry({"21.5"});
  site_->stop_after_the_next();
  const auto done = run({"channel", "echo", id_, "readings"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.out, HasSubstr("21.5"));
  EXPECT_THAT(done.err, AllOf(HasSubstr("is inactive"), HasSubstr("iotcloud start")));
}

TEST_F(CliChannels, HzAndBwTellWhatTheHostHasCounted) {
  site_->carry({"21.5", std::string(1200, 'x')});
  const auto hz = run({"channel", "hz", id_, "readings", "-n", "1", "--every", "0.1"});
  EXPECT_THAT(hz.out, AllOf(HasSubstr("2.0 messages/s"), HasSubstr("19.0 to 21.0 ms apart"))) << hz.err;
  const auto bw = run({"channel", "bw", id_, "readings", "--once", "--every", "0.1"});
  EXPECT_THAT(bw.out, AllOf(HasSubstr("1.2 kB/s"), HasSubstr("messages of 4 B to 1.2 kB"))) << bw.err;
  const auto json = run_json({"channel", "hz", id_, "readings", "--once", "--every", "0.1"});
  EXPECT_DOUBLE_EQ(json["messages_per_s"], 2);
}

TEST_F(CliChannels, PublishHandsAMessageOfTextBytesOrAFile) {
  const auto done = run({"channel", "publish", id_, "control", "on", "--property", "who=anna"});
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_THAT(done.out, HasSubstr("its driver has handled"));
  run({"channel", "publish", id_, "control", "--hex", "00 ff"});
  const tests::TemporaryFolder folder;
  tests::write_file(folder / "message", "from a file");
  run({"channel", "publish", id_, "control", "--file", folder / "message"});
  const auto handed = site_->handed();
  ASSERT_EQ(handed.size(), 3U);
  EXPECT_EQ(handed[0].payload, "on");
  EXPECT_EQ(handed[0].instance, id_);
  EXPECT_EQ(handed[0].properties.at("who"), "anna");
  EXPECT_EQ(handed[1].payload, "\0\xff"s);
  EXPECT_EQ(handed[2].payload, "from a file");
  site_->refuse("channel \"readings\" is outgoing");
  const auto refused = run({"channel", "publish", id_, "readings", "on"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, HasSubstr("is outgoing"));
  EXPECT_EQ(run({"channel", "publish", id_, "control"}).status, 2);
  EXPECT_EQ(run({"channel", "publish", id_, "control", "--hex", "0g"}).status, 2);
}

/// Knows no method, as a gateway of an earlier version knows no new one.
class NoMethod final : public apache::thrift::TProcessor {
 public:
  explicit NoMethod(std::shared_ptr<apache::thrift::TProcessor> rest) : rest_(std::move(rest)) {}
  bool process(std::shared_ptr<apache::thrift::protocol::TProtocol> in,
               std::shared_ptr<apache::thrift::protocol::TProtocol> out, void* context) override {
    if (asked_++ % 2 == 0) return rest_->process(in, out, context);  // ping() comes first
    std::string name;
    apache::thrift::protocol::TMessageType type{};
    std::int32_t number = 0;
    in->readMessageBegin(name, type, number);
    in->skip(apache::thrift::protocol::T_STRUCT);
    in->readMessageEnd();
    out->writeMessageBegin(name, apache::thrift::protocol::T_EXCEPTION, number);
    apache::thrift::TApplicationException(apache::thrift::TApplicationException::UNKNOWN_METHOD).write(out.get());
    out->writeMessageEnd();
    out->getTransport()->writeEnd();
    out->getTransport()->flush();
    return true;
  }

 private:
  const std::shared_ptr<apache::thrift::TProcessor> rest_;
  int asked_ = 0;
};

TEST_F(CliChannels, AnOlderGatewayIsNamed) {
  serve(std::make_shared<NoMethod>(std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(site_)));
  const auto done = run({"channel", "echo", id_, "readings"});
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, HasSubstr("gateway lab1 runs an older version, which does not know this question"));
}

}  // namespace
}  // namespace iotcloud::master::test
