#include <chrono>
#include <string>
#include <variant>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/protocol.h>
#include <iotcloud/processes/frames.h>

namespace iotcloud::gateway::protocol {
namespace {

using testing::HasSubstr;

std::string body_of(const std::string& frame) {
  processes::FrameReader reader;
  reader.feed(frame.data(), frame.size());
  return reader.next().value();
}

PassedMessage passed_message() {
  PassedMessage passed;
  passed.number = 1'577'836'800'000'000'007;
  passed.topic = "gw.p.control";
  passed.message.driver_id = "a";
  passed.message.gateway_id = "gw";
  passed.message.time_ms = 1234;
  passed.message.properties.set("key", std::string("\0\xFF\x80", 3));
  passed.message.properties.set("", "empty");
  std::string all;
  for (int byte = 0; byte < 256; ++byte) all.push_back(static_cast<char>(byte));
  passed.message.payload = brokers::Payload::copy(all);
  return passed;
}

void expect_same(const PassedMessage& read, const PassedMessage& written) {
  EXPECT_EQ(read.number, written.number);
  EXPECT_EQ(read.topic, written.topic);
  EXPECT_EQ(read.message.driver_id, written.message.driver_id);
  EXPECT_EQ(read.message.gateway_id, written.message.gateway_id);
  EXPECT_EQ(read.message.time_ms, written.message.time_ms);
  EXPECT_EQ(read.message.properties, written.message.properties);
  EXPECT_EQ(read.message.payload, written.message.payload);
}

/// What the gateway reads of this report of a host.
template <typename Kind>
Kind reported(const Kind& report) {
  return std::get<Kind>(decode_report(body_of(encode(HostReport(report)))));
}
/// What the host reads of this command.
template <typename Kind>
Kind commanded(const Kind& command) {
  return std::get<Kind>(decode_command(body_of(encode(HostCommand(command)))));
}

TEST(HostProtocol, CarriesAPassedMessageOfAnyBytesInBothDirections) {
  expect_same(reported(PassMessage{passed_message()}).passed, passed_message());
  expect_same(commanded(DeliverMessage{passed_message()}).passed, passed_message());
}

TEST(HostProtocol, KnowsAHostThatAnswersNoQuestionsBecauseItIsOlder) {
  HostHello hello;
  hello.answers = true;
  std::string body = body_of(encode(hello));
  EXPECT_TRUE(std::get<HostHello>(decode_report(body)).answers);
  const std::string key = "\"answers\":true,";
  const auto at = body.find(key);
  ASSERT_NE(at, std::string::npos) << body;
  body.erase(at, key.size());
  EXPECT_FALSE(std::get<HostHello>(decode_report(body)).answers);
}

TEST(HostProtocol, ReadsOnlyTheVersionOfAHostThatHasAnotherOne) {
  const auto hello = std::get<HostHello>(decode_report(R"({"kind":"hello","version":4,"plugin":7,"instances":"all"})"));
  EXPECT_EQ(hello.version, 4);
  EXPECT_TRUE(hello.instances.empty());
  EXPECT_THROW(decode_report(R"({"kind":"hello","version":"4"})"), config::Error);
}

TEST(HostProtocol, CarriesTheStatesOfBrokersWithAPong) {
  Pong pong;
  pong.brokers = {{"red", "amqp://red/", "away", 1234, "connection refused"}};
  EXPECT_EQ(reported(pong).brokers, pong.brokers);
  EXPECT_TRUE(reported(Pong{}).brokers.empty());
}

TEST(HostProtocol, CarriesQuestionsAboutChannelsAndTheirAnswers) {
  AskAboutChannel ask;
  ask.number = 7;
  ask.question.look.instance = discovery::InstanceId("a");
  ask.question.look.channel = "control";
  ask.question.look.most = 5;
  ask.question.message = passed_message().message;
  const auto read = commanded(ask);
  EXPECT_EQ(read.number, 7);
  EXPECT_EQ(read.question.look.instance, "a");
  EXPECT_EQ(read.question.look.channel, "control");
  EXPECT_EQ(read.question.look.most, 5);
  ASSERT_TRUE(read.question.message);
  EXPECT_EQ(read.question.message->payload, ask.question.message->payload);
  ask.question.message.reset();
  EXPECT_FALSE(commanded(ask).question.message);

  ChannelAnswer answer;
  answer.number = 7;
  answer.look.count = 9;
  answer.look.channels.emplace_back().name = "control";
  auto& seen = answer.look.messages.emplace_back();
  seen.payload = passed_message().message.payload.text();
  seen.properties["key"] = "\xFF";
  const auto told = reported(answer);
  EXPECT_EQ(told.number, 7);
  EXPECT_EQ(told.look.count, 9);
  EXPECT_EQ(told.look.channels.at(0).name, "control");
  EXPECT_EQ(told.look.messages.at(0).payload, seen.payload);
  EXPECT_EQ(told.look.messages.at(0).properties.at("key"), "\xFF");
}

/// 4 MiB of zeros, most of them in the properties or in the payload.
PassedMessage large_message(bool in_properties) {
  PassedMessage passed;
  const std::string zeros(std::size_t{4} << 20, '\0');
  if (in_properties) {
    passed.message.properties.set("huge", zeros);
  } else {
    passed.message.payload = brokers::Payload::copy(zeros);
  }
  return passed;
}

TEST(HostProtocol, CarriesALargePassedMessageOfBytesThatJsonWritesAsSixCharacters) {
  const PassMessage pass{large_message(false)};
  EXPECT_TRUE(processes::fits(encode(pass))) << encode(pass).size();
  expect_same(reported(pass).passed, pass.passed);
  const DeliverMessage deliver{large_message(true)};
  EXPECT_TRUE(processes::fits(encode(deliver))) << encode(deliver).size();
  expect_same(commanded(deliver).passed, deliver.passed);
}

TEST(HostProtocol, TellsOfAFrameThatItsReaderWouldRefuse) {
  const auto largest = processes::frame(std::string(processes::max_frame, 'x'));
  EXPECT_TRUE(processes::fits(largest));
  EXPECT_EQ(body_of(largest).size(), processes::max_frame);
  const auto larger = processes::frame(std::string(processes::max_frame + 1, 'x'));
  EXPECT_FALSE(processes::fits(larger));
  EXPECT_THROW(body_of(larger), config::Error);
}

TEST(HostProtocol, CarriesEveryAnswer) {
  for (const auto answer : {PassAnswer::handled, PassAnswer::failed, PassAnswer::comes, PassAnswer::nowhere}) {
    for (const auto& read : {reported(AnswerMessage{7, answer}), commanded(AnswerMessage{7, answer})}) {
      EXPECT_EQ(read.answer, answer);
      EXPECT_EQ(read.number, 7);
    }
  }
}

TEST(HostProtocol, CarriesTheTimeOfAConfirmation) {
  const std::chrono::nanoseconds a_year = std::chrono::hours(24 * 365);
  EXPECT_EQ(commanded(RenewLeases{a_year}).confirmed, a_year);
}

TEST(HostProtocol, RefusesAMessageThatIsNestedDeeply) {
  const auto pong = [](std::size_t levels) {
    return R"({"kind":"pong","number":1,"stalls":[],"more":)" + std::string(levels, '[') + std::string(levels, ']') +
           "}";
  };
  EXPECT_EQ(std::get<Pong>(decode_report(pong(10))).number, 1);
  EXPECT_THROW(decode_report(pong(1'000'000)), config::Error);
}

/// Gateways and hosts of version 5 that were built before each kind had a struct of its own wrote these bytes.
TEST(HostProtocol, ReadsAndWritesTheBytesThatOlderGatewaysAndHostsOfThisVersionDo) {
  for (
      const std::string body : {
          R"({"kind":"create","spec":{"brokers":[{"ca":"","certificate":"","heartbeat_ms":60000,"key":"","name":"red","own":["amqp://red/"],"password_file":"","password_variable":"","properties":{},"shared":[],"type":"rabbitmq","user":""}],"order":"{\"active\":true,\"driver\":\"\",\"epoch\":3,\"instance\":\"01\",\"metadata\":{},\"plugin\":\"turtle.so\",\"properties\":{}}"}})",
          R"({"instance":"01","kind":"activate"})",
          R"({"instance":"01","kind":"deactivate"})",
          R"({"instance":"01","kind":"remove"})",
          R"({"instance":"01","kind":"remove","number":1})",
          R"({"kind":"shutdown","number":500})",
          R"({"kind":"ping","number":1})",
          R"({"kind":"metrics"})",
          R"({"kind":"deliver","passed":{"gateway":"","instance":"MDE=","number":3,"payload":"b24=","properties":[["dW5pdA==","AP8="]],"time":0,"topic":"Z3cudHVydGxlLmNvbnRyb2w="}})",
          R"({"answer":"nowhere","kind":"answer","number":3})",
          R"({"kind":"renew","number":1000000007})",
          R"({"kind":"ask","message":{"gateway":"","instance":"MDE=","number":0,"payload":"b24=","properties":[],"time":0,"topic":""},"number":7,"question":{"bytes":0,"channel":"control","instance":"01","last":false,"look":"a","most":5}})",
          R"({"kind":"ask","number":7,"question":{"bytes":0,"channel":"","instance":"01","last":true,"look":"","most":0}})",
          R"({"kind":"prove","proof":"aa"})",
      })
    EXPECT_EQ(body_of(encode(decode_command(body))), body);
  for (
      const std::string body : {
          R"({"answers":true,"found":["ab","anna"],"gateway":"gw","instances":[{"spec":{"brokers":[],"order":"{\"active\":true,\"driver\":\"\",\"epoch\":0,\"instance\":\"01\",\"metadata\":{},\"plugin\":\"turtle.so\",\"properties\":{}}"},"status":{"channels":[{"driver":"turtle","gateway":"gw","instance":"01","name":"control","out":false,"properties":{},"shared":true,"transport":"red","url":"amqp://red/"}],"driver":"turtle","instance":"01","metadata":{"a":"b"},"reason":"","since_ms":5,"state":"active"}}],"isolated":true,"kind":"hello","plugin":"turtle.so","sha256":"ab","version":6})",
          R"({"kind":"refused","reason":"no"})",
          R"({"kind":"status","status":{"channels":[],"driver":"turtle","instance":"01","metadata":{},"reason":"why","since_ms":5,"state":"failed"}})",
          R"({"kind":"pong","number":1,"stalls":[{"instance":"01","limit_ms":20,"ms":7,"own_thread":true},{"instance":"","ms":7,"own_thread":false}]})",
          R"({"brokers":[{"broker":"red","since_ms":5,"state":"away","url":"amqp://red/","why":"refused"}],"kind":"pong","number":1,"stalls":[]})",
          R"({"kind":"metrics","samples":[{"help":"h","kind":0,"labels":{"a":"b"},"name":"x","value":1.5},{"help":"h","histogram":[7,1.0,2.0,3.0,4.5],"kind":2,"labels":{},"name":"y"}]})",
          R"({"kind":"pass","passed":{"gateway":"","instance":"MDE=","number":3,"payload":"","properties":[],"time":9,"topic":""}})",
          R"({"answer":"comes","kind":"answer","number":3})",
          R"({"kind":"told","look":{"bytes":0,"channels":[],"count":1,"elapsed_us":0,"largest":0,"longest_us":0,"messages":[{"number":1,"payload":"b24=","properties":{"dW5pdA==":"AP8="},"seen_ms":0,"size":2,"time_ms":0}],"missed":0,"shortest_us":0,"smallest":0,"state":"active"},"number":7})",
      })
    EXPECT_EQ(body_of(encode(decode_report(body))), body);
}

TEST(HostProtocol, NamesTheFieldThatAMessageLacksOrThatIsOfAnotherType) {
  const auto complaint = [](const std::string& body) -> std::string {
    try {
      decode_command(body);
    } catch (const config::Error& error) {
      return error.what();
    }
    return "none";
  };
  EXPECT_THAT(complaint(R"({"kind":"create"})"), HasSubstr("the key \"spec\" is missing"));
  EXPECT_THAT(complaint(R"({"kind":"remove","instance":"01","number":1.5})"), HasSubstr("the key \"number\""));
  EXPECT_THAT(complaint(R"({"kind":"shutdown","number":9223372036854775808})"), HasSubstr("out of range"));
  EXPECT_THAT(complaint(R"({"kind":"hello"})"), HasSubstr("\"hello\" is no message"));
}

TEST(HostProtocol, RefusesAPassedMessageThatCannotBe) {
  EXPECT_THROW(decode_report(R"({"kind":"answer","number":7,"answer":"perhaps"})"), config::Error);
  EXPECT_THROW(decode_report(R"({"kind":"pass","passed":{"number":7}})"), config::Error);
  for (const std::string topic : {"\xE2\x82\xAC", "A", "A===", "QQ=A", "QUJD!AAA"}) {
    auto passed = body_of(encode(PassMessage{passed_message()}));
    const std::string written = "\"topic\":\"Z3cucC5jb250cm9s\"";
    ASSERT_NE(passed.find(written), std::string::npos) << passed;
    passed.replace(passed.find(written), written.size(), "\"topic\":\"" + topic + "\"");
    EXPECT_THROW(decode_report(passed), config::Error) << topic;
  }
}

}  // namespace
}  // namespace iotcloud::gateway::protocol
