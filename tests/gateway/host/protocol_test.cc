#include <chrono>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/protocol.h>
#include <iotcloud/processes/frames.h>

namespace iotcloud::gateway::protocol {
namespace {

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

TEST(HostProtocol, CarriesAPassedMessageOfAnyBytesInBothDirections) {
  HostReport report;
  report.kind = HostReport::Kind::pass;
  report.passed = passed_message();
  expect_same(decode_report(body_of(encode(report))).passed, report.passed);
  HostCommand command;
  command.kind = HostCommand::Kind::deliver;
  command.passed = passed_message();
  expect_same(decode_command(body_of(encode(command))).passed, command.passed);
}

TEST(HostProtocol, KnowsAHostThatAnswersNoQuestionsBecauseItIsOlder) {
  HostReport hello;
  hello.kind = HostReport::Kind::hello;
  hello.answers = true;
  std::string body = body_of(encode(hello));
  EXPECT_TRUE(decode_report(body).answers);
  const std::string key = "\"answers\":true,";
  const auto at = body.find(key);
  ASSERT_NE(at, std::string::npos) << body;
  body.erase(at, key.size());
  EXPECT_FALSE(decode_report(body).answers);
}

TEST(HostProtocol, CarriesTheStatesOfBrokersWithAPong) {
  HostReport report;
  report.kind = HostReport::Kind::pong;
  report.brokers = {{"red", "amqp://red/", "away", 1234, "connection refused"}};
  EXPECT_EQ(decode_report(body_of(encode(report))).brokers, report.brokers);
  report.brokers.clear();
  EXPECT_TRUE(decode_report(body_of(encode(report))).brokers.empty());
}

TEST(HostProtocol, CarriesQuestionsAboutChannelsAndTheirAnswers) {
  HostCommand command;
  command.kind = HostCommand::Kind::ask;
  command.number = 7;
  command.question.look.instance = discovery::InstanceId("a");
  command.question.look.channel = "control";
  command.question.look.most = 5;
  command.question.message = passed_message().message;
  const auto read = decode_command(body_of(encode(command)));
  EXPECT_EQ(read.number, 7);
  EXPECT_EQ(read.question.look.instance, "a");
  EXPECT_EQ(read.question.look.channel, "control");
  EXPECT_EQ(read.question.look.most, 5);
  ASSERT_TRUE(read.question.message);
  EXPECT_EQ(read.question.message->payload, command.question.message->payload);
  command.question.message.reset();
  EXPECT_FALSE(decode_command(body_of(encode(command))).question.message);

  HostReport report;
  report.kind = HostReport::Kind::told;
  report.number = 7;
  report.look.count = 9;
  report.look.channels.emplace_back().name = "control";
  auto& seen = report.look.messages.emplace_back();
  seen.payload = passed_message().message.payload.text();
  seen.properties["key"] = "\xFF";
  const auto told = decode_report(body_of(encode(report)));
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
  HostReport report;
  report.kind = HostReport::Kind::pass;
  report.passed = large_message(false);
  const auto reported = encode(report);
  ASSERT_TRUE(processes::fits(reported)) << reported.size();
  expect_same(decode_report(body_of(reported)).passed, report.passed);
  HostCommand command;
  command.kind = HostCommand::Kind::deliver;
  command.passed = large_message(true);
  const auto commanded = encode(command);
  ASSERT_TRUE(processes::fits(commanded)) << commanded.size();
  expect_same(decode_command(body_of(commanded)).passed, command.passed);
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
    HostReport report;
    report.kind = HostReport::Kind::answer;
    report.number = 7;
    report.answer = answer;
    const auto reported = decode_report(body_of(encode(report)));
    EXPECT_EQ(reported.answer, answer);
    EXPECT_EQ(reported.number, 7);
    HostCommand command;
    command.kind = HostCommand::Kind::answer;
    command.number = 7;
    command.answer = answer;
    const auto commanded = decode_command(body_of(encode(command)));
    EXPECT_EQ(commanded.answer, answer);
    EXPECT_EQ(commanded.number, 7);
  }
}

TEST(HostProtocol, CarriesTheTimeOfAConfirmation) {
  const std::int64_t a_year = std::chrono::nanoseconds(std::chrono::hours(24 * 365)).count();
  const auto renewed = decode_command(body_of(encode({HostCommand::Kind::renew, {}, {}, a_year})));
  EXPECT_EQ(renewed.kind, HostCommand::Kind::renew);
  EXPECT_EQ(renewed.number, a_year);
}

TEST(HostProtocol, RefusesAMessageThatIsNestedDeeply) {
  const auto pong = [](std::size_t levels) {
    return R"({"kind":"pong","number":1,"stalls":[],"more":)" + std::string(levels, '[') + std::string(levels, ']') +
           "}";
  };
  EXPECT_EQ(decode_report(pong(10)).number, 1);
  EXPECT_THROW(decode_report(pong(1'000'000)), config::Error);
}

TEST(HostProtocol, RefusesAPassedMessageThatCannotBe) {
  EXPECT_THROW(decode_report(R"({"kind":"answer","number":7,"answer":"perhaps"})"), config::Error);
  EXPECT_THROW(decode_report(R"({"kind":"pass","passed":{"number":7}})"), config::Error);
  for (const std::string topic : {"\xE2\x82\xAC", "A", "A===", "QQ=A", "QUJD!AAA"}) {
    HostReport report;
    report.kind = HostReport::Kind::pass;
    report.passed = passed_message();
    auto passed = body_of(encode(report));
    const std::string written = "\"topic\":\"Z3cucC5jb250cm9s\"";
    ASSERT_NE(passed.find(written), std::string::npos) << passed;
    passed.replace(passed.find(written), written.size(), "\"topic\":\"" + topic + "\"");
    EXPECT_THROW(decode_report(passed), config::Error) << topic;
  }
}

}  // namespace
}  // namespace iotcloud::gateway::protocol
