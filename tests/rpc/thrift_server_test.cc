// A Thrift server before clients that mean it harm, or have gone: they are cut off and counted, and others are served.
#include <algorithm>
#include <future>
#include <optional>
#include <vector>

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <thrift/Thrift.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/rpc/listen_settings.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/rpc/service.h>

namespace iotcloud::rpc {
namespace {

using std::chrono::milliseconds;
using test::ask;
using test::call_frame;
using test::client_of;
using test::RawClient;
using test::refusals;
using testing::HasSubstr;

class ThriftServerTest : public testing::Test {
 protected:
  ThriftServerTest() { options_.name = testing::UnitTest::GetInstance()->current_test_info()->name(); }

  void serve(const std::shared_ptr<apache::thrift::TProcessor>& processor = std::make_shared<test::Greeter>()) {
    server_.emplace(options_, [processor](const auto&) { return processor; });
  }
  std::uint64_t refused(const std::string& reason) const { return refusals(options_.name, reason); }
  static bool is_answered(const ThriftClient& client) { return is_answered_as(client, "hello"); }
  static bool is_answered_as(const ThriftClient& client, const std::string& answer) {
    try {
      return ask(client) == answer;
    } catch (const apache::thrift::TException&) {
      return false;
    }
  }
  void others_are_served() const { EXPECT_EQ(ask(ThriftClient(client_of(server_->port()))), "hello"); }

  ThriftServerOptions options_;
  std::optional<ThriftServer> server_;
};

TEST_F(ThriftServerTest, CallsAreAnsweredOneAfterTheOther) {
  serve();
  const ThriftClient client(client_of(server_->port()));
  EXPECT_EQ(ask(client), "hello");
  EXPECT_EQ(ask(client, "size:3000000").size(), 3'000'000u);
  EXPECT_EQ(ask(client), "hello");
}

TEST_F(ThriftServerTest, AMessageAboveTheLimitEndsItsConnectionOnly) {
  options_.max_message_bytes = 10'000;
  serve();
  RawClient client(server_->port());
  client.send(call_frame("greet"));
  EXPECT_TRUE(client.is_answered());
  RawClient large(server_->port());
  large.send(std::string("\0\1\0\0", 4));
  EXPECT_TRUE(large.is_cut_off());
  EXPECT_EQ(refused("size"), 1u);
  others_are_served();
}

TEST_F(ThriftServerTest, AStrangersMessagesAreSmallAndThoseOfOthersMayBeLarge) {
  options_.max_stranger_bytes = 1'000;
  serve();
  const std::string large(5'000, 'm');
  RawClient stranger(server_->port());
  stranger.send(call_frame(large));
  EXPECT_TRUE(stranger.is_cut_off());
  EXPECT_EQ(refused("size"), 1u);
  const ThriftClient known(client_of(server_->port()));
  ask(known);
  EXPECT_EQ(ask(known, large), "hello");
}

TEST_F(ThriftServerTest, AListThatClaimsMoreThanItsMessageHasIsRefused) {
  serve();
  for (const std::int32_t claimed : {100, 100'001, 0x7fffffff}) {
    RawClient client(server_->port());
    client.send(call_frame("greet", claimed));
    EXPECT_TRUE(client.is_cut_off()) << claimed;
  }
  EXPECT_EQ(refused("message"), 3u);
  others_are_served();
}

TEST_F(ThriftServerTest, BytesThatAreNoThriftEndTheirConnectionOnly) {
  serve();
  RawClient client(server_->port());
  client.send(std::string("\0\0\0\x08\xff\xff\xff\xff\x7f\xff\xff\xff", 12));
  EXPECT_TRUE(client.is_cut_off());
  RawClient empty(server_->port());
  empty.send(std::string(4, '\0'));
  EXPECT_TRUE(empty.is_cut_off());
  EXPECT_EQ(refused("message"), 2u);
  others_are_served();
}

TEST_F(ThriftServerTest, AFloodOfRefusedClientsIsCountedAndLoggedOnce) {
  serve();
  constexpr std::uint64_t flood = 40;
  const std::uint64_t before = refused("message");
  const tests::CapturedLog log;
  for (std::uint64_t i = 0; i < flood; ++i) {
    RawClient client(server_->port());
    client.send(std::string(4, '\0'));
    EXPECT_TRUE(client.is_cut_off());
  }
  ASSERT_TRUE(tests::eventually([&] { return refused("message") == before + flood; }));
  const std::string said = log.text();
  const auto first = said.find("is cut off");
  ASSERT_NE(first, std::string::npos) << said;
  EXPECT_EQ(said.find("is cut off", first + 1), std::string::npos) << said;
}

#if !defined(IOTCLOUD_SANITIZED)  // the sanitizer opens a pipe to look at an object's type
TEST_F(ThriftServerTest, WithoutDescriptorsItWaitsSaysSoOnceAndGoesOnWhenThereAreSome) {
  serve();
  const std::uint64_t before = refused("connections");
  const int client = socket(AF_INET, SOCK_STREAM, 0);
  ASSERT_GE(client, 0);
  const tests::CapturedLog log;
  rlimit usual{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &usual), 0);
  std::vector<int> taken;
  for (int fd = dup(0); fd >= 0; fd = dup(0)) {
    taken.push_back(fd);
    rlimit few = usual;
    few.rlim_cur = static_cast<rlim_t>(fd) + 1;
    ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  }
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(server_->port()));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  EXPECT_EQ(connect(client, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  EXPECT_TRUE(tests::eventually([&] { return refused("connections") >= before + 2; }));
  setrlimit(RLIMIT_NOFILE, &usual);
  for (const int fd : taken) close(fd);
  const std::string call = call_frame("greet");
  EXPECT_EQ(write(client, call.data(), call.size()), static_cast<ssize_t>(call.size()));
  char byte = 0;
  EXPECT_EQ(read(client, &byte, 1), 1) << "the connection that waited is served";
  close(client);
  others_are_served();
  const std::string said = log.text();
  const auto first = said.find("a connection cannot be accepted");
  ASSERT_NE(first, std::string::npos) << said;
  EXPECT_EQ(said.find("a connection cannot be accepted", first + 1), std::string::npos) << said;
}
#endif

TEST_F(ThriftServerTest, OneThatSaysNothingIsCutOff) {
  options_.stranger_limit = milliseconds{50};
  serve();
  RawClient silent(server_->port());
  EXPECT_TRUE(silent.is_cut_off());
  EXPECT_EQ(refused("slow"), 1u);
}

TEST_F(ThriftServerTest, OneThatWasAnsweredMayBeSilentForLong) {
  options_.stranger_limit = milliseconds{50};
  serve();
  std::optional<ThriftClient> client;
  ASSERT_TRUE(tests::eventually([&] {  // on a busy machine its first call may come too late
    client.emplace(client_of(server_->port()));
    return is_answered(*client);
  }));
  RawClient stranger(server_->port());
  EXPECT_TRUE(stranger.is_cut_off());  // so the limit has passed
  EXPECT_EQ(ask(*client), "hello");
}

TEST_F(ThriftServerTest, AMessageThatDripsDoesNotProlongItsLimit) {
  options_.message_limit = milliseconds{100};
  serve();
  RawClient slow(server_->port());
  slow.send(call_frame("greet"));
  EXPECT_TRUE(slow.is_answered());
  slow.send(std::string("\0\0\x27\x10", 4));
  others_are_served();
  EXPECT_TRUE(slow.is_cut_off_dripping());
  EXPECT_EQ(refused("slow"), 1u);
}

TEST_F(ThriftServerTest, AStrangersMessageThatDripsDoesNotProlongItsLimit) {
  options_.stranger_limit = milliseconds{100};
  serve();
  RawClient slow(server_->port());
  slow.send(std::string("\0\0\x27\x10", 4));
  EXPECT_TRUE(slow.is_cut_off_dripping());
  EXPECT_EQ(refused("slow"), 1u);
}

TEST_F(ThriftServerTest, OneThatDoesNotReadItsAnswersIsCutOff) {
  options_.message_limit = milliseconds{200};
  serve();
  RawClient deaf(server_->port());
  deaf.send(call_frame("size:40000000"));  // more than the system keeps for the two of them
  others_are_served();
  EXPECT_TRUE(tests::eventually([&] { return refused("slow") == 1; }));
}

TEST_F(ThriftServerTest, WhenAllPlacesAreTakenStrangersMakeRoom) {
  options_.max_connections = 2;
  serve();
  const ThriftClient known(client_of(server_->port()));
  ask(known);
  RawClient stranger(server_->port());
  const ThriftClient late(client_of(server_->port()));
  EXPECT_EQ(ask(late), "hello");
  EXPECT_TRUE(stranger.is_cut_off());
  EXPECT_EQ(ask(known), "hello");
  EXPECT_EQ(refused("connections"), 1u);
}

TEST_F(ThriftServerTest, WhenAllPlacesAreTakenByThoseWhoAreKnownTheIdlestMakesRoom) {
  options_.max_connections = 2;
  serve();
  const ThriftClient first(client_of(server_->port()));
  const ThriftClient second(client_of(server_->port()));
  ask(first);
  ask(second);
  // A connection is idle when its answer was sent, which its client may see a moment earlier than the server.
  EXPECT_TRUE(tests::eventually([&] { return is_answered(ThriftClient(client_of(server_->port()))); }));
  EXPECT_NE(is_answered(first), is_answered(second)) << "one of them made room";
  EXPECT_GE(refused("connections"), 1u);
}

/// Gives each connection an identity: that of its first call's method.
class NamingService {
 public:
  static std::shared_ptr<apache::thrift::TProcessor> serve(const std::shared_ptr<ThriftPeer>& peer) {
    return std::make_shared<Naming>(peer);
  }

 private:
  class Naming final : public apache::thrift::TProcessor {
   public:
    explicit Naming(std::shared_ptr<ThriftPeer> peer) : peer_(std::move(peer)) {}
    bool process(std::shared_ptr<apache::thrift::protocol::TProtocol> in,
                 std::shared_ptr<apache::thrift::protocol::TProtocol> out, void*) override {
      const auto [method, number] = test::read_call(*in);
      if (!peer_->named()) peer_->set_identity(method);
      out->writeMessageBegin(method, apache::thrift::protocol::T_REPLY, number);
      out->writeString(peer_->identity());
      out->writeMessageEnd();
      return true;
    }

   private:
    const std::shared_ptr<ThriftPeer> peer_;
  };
};

TEST_F(ThriftServerTest, OneIdentitysConnectionsDoNotCloseTheServerForOthers) {
  options_.max_connections = 8;
  server_.emplace(options_, NamingService::serve);
  const ThriftClient anna(client_of(server_->port()));
  EXPECT_EQ(ask(anna, "anna"), "anna");
  std::vector<std::unique_ptr<ThriftClient>> flood;
  for (int i = 0; i < 40; ++i) {
    flood.push_back(std::make_unique<ThriftClient>(client_of(server_->port())));
    EXPECT_EQ(ask(*flood.back(), "vera"), "vera");
  }
  const ThriftClient otto(client_of(server_->port()));
  EXPECT_EQ(ask(otto, "otto"), "otto");
  EXPECT_EQ(ask(anna), "anna") << "one who had a connection before the flood keeps it";
}

TEST_F(ThriftServerTest, OneIdentityHasSoManyConnectionsAndNoMore) {
  options_.max_connections_of_one = 3;
  server_.emplace(options_, NamingService::serve);
  std::vector<std::unique_ptr<ThriftClient>> many;
  for (int i = 0; i < 6; ++i) {
    many.push_back(std::make_unique<ThriftClient>(client_of(server_->port())));
    EXPECT_EQ(ask(*many.back(), "vera"), "vera");
  }
  EXPECT_EQ(ask(*many.back()), "vera");
  EXPECT_GE(refused("connections_of_one"), 1u);  // it looks when the next one comes
  const auto open =
      std::count_if(many.begin(), many.end(), [](const auto& one) { return is_answered_as(*one, "vera"); });
  EXPECT_LE(open, 4);
}

TEST_F(ThriftServerTest, OneThatIsKnownAndSaysNothingIsClosedInTheEnd) {
  options_.idle_limit = milliseconds{50};
  serve();
  RawClient idle(server_->port());
  idle.send(call_frame("greet"));
  EXPECT_TRUE(idle.is_cut_off());
}

TEST_F(ThriftServerTest, ClientsThatOnlyHoldTheirConnectionDoNotHoldUpTheStop) {
  serve();
  const ThriftClient known(client_of(server_->port()));
  ask(known);
  const RawClient stranger(server_->port());
  auto stopped = std::async(std::launch::async, [&] { server_.reset(); });
  EXPECT_EQ(stopped.wait_for(test::patience), std::future_status::ready);
}

TEST_F(ThriftServerTest, APortInUseIsAnErrorThatNamesIt) {
  serve();
  options_.port = server_->port();
  try {
    const ThriftServer second(options_, [](const auto&) { return std::make_shared<test::Greeter>(); });
    FAIL() << "the port is taken";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("127.0.0.1:" + std::to_string(options_.port)));
  }
}

TEST(ThriftClientTest, AnAnswerThatDoesNotComeIsATimeOut) {
  ThriftServerOptions options;
  std::promise<void> may_end;
  class Hanging final : public apache::thrift::TProcessor {
   public:
    explicit Hanging(std::future<void> end) : end_(std::move(end)) {}
    bool process(std::shared_ptr<apache::thrift::protocol::TProtocol>,
                 std::shared_ptr<apache::thrift::protocol::TProtocol>, void*) override {
      end_.wait();
      return false;
    }

   private:
    std::future<void> end_;
  };
  const auto processor = std::make_shared<Hanging>(may_end.get_future());
  const ThriftServer server(options, [processor](const auto&) { return processor; });
  auto quick = client_of(server.port());
  quick.answer_limit = milliseconds{20};
  const ThriftClient client(quick);
  EXPECT_THROW(ask(client), apache::thrift::TException);
  may_end.set_value();
}

TEST(LoopbackAddresses, AreKnown) {
  using config::is_loopback;
  for (const char* host : {"127.0.0.1", "127.1.2.3", "::1", "localhost"}) EXPECT_TRUE(is_loopback(host)) << host;
  for (const char* host : {"0.0.0.0", "::", "192.168.1.2", "example.org", "127.0.0.1.example.org", ""})
    EXPECT_FALSE(is_loopback(host)) << host;
}

TEST(Addresses, AreSplitAtTheLastColon) {
  EXPECT_EQ(split_address("lab1:12904").host, "lab1");
  EXPECT_EQ(split_address("lab1:12904").port, 12904);
  EXPECT_EQ(split_address("[::1]:1").host, "::1");
  for (const char* wrong : {"", "lab1", "lab1:", ":1", "lab1:0", "lab1:65536", "lab1:1x", "[]:1"})
    EXPECT_THROW(split_address(wrong), config::Error) << wrong;
}

}  // namespace
}  // namespace iotcloud::rpc
