// Connections that another process makes for this one, which is not confined here; hosts that are: tests/gateway/fleet.
#include <array>
#include <cerrno>
#include <cstring>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include <arpa/inet.h>
#include <fcntl.h>
#include <gmock/gmock.h>
#include <netdb.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <iotcloud/processes/connector.h>
#include <iotcloud/processes/connector_request.h>
#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/landlock.h>
#include <iotcloud/tests/loopback_listener.h>

namespace iotcloud::processes {
namespace {

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return to;
}

TEST(ConnectorRequest, ComesWithItsDescriptorsAndAnAddressOrAName) {
  ConnectRequest connect;
  const auto to = loopback(80);
  std::memcpy(&connect.address, &to, sizeof to);
  connect.size = sizeof to;
  const std::string bytes = encode(connect);
  const auto read = decode_connector_request(bytes, 2);
  ASSERT_TRUE(read && std::holds_alternative<ConnectRequest>(*read));
  EXPECT_EQ(encode(*read), bytes);
  for (const std::size_t descriptors : {0, 1, 3}) EXPECT_FALSE(decode_connector_request(bytes, descriptors));
  EXPECT_FALSE(decode_connector_request(bytes.substr(0, 2), 2));
  EXPECT_FALSE(decode_connector_request("c" + std::string(sizeof(sockaddr_storage) + 1, 'x'), 2));
  const auto found = decode_connector_request(encode(FindRequest{"lab1", true}), 1);
  ASSERT_TRUE(found && std::holds_alternative<FindRequest>(*found));
  EXPECT_EQ(std::get<FindRequest>(*found).name, "lab1");
  EXPECT_TRUE(std::get<FindRequest>(*found).configured);
  for (const char* none : {"", "f", "f1", "x1lab1"}) EXPECT_FALSE(decode_connector_request(none, 1)) << none;
  EXPECT_FALSE(decode_connector_request("f1lab1", 0));
}

class ConnectorTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (landlock_version() == 0) GTEST_SKIP() << "this kernel has no Landlock";
    start_connector({{{"127.0.0.1", listener_.port()}, {"localhost", 1}}, "add it"});
  }
  /// \return 0 or errno
  static int connect_to(std::uint16_t port, int socket) {
    const auto to = loopback(port);
    return connect_through(socket, reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0 ? 0 : errno;
  }
  static OwnedDescriptor stream(int flags = 0) {
    return OwnedDescriptor(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | flags, 0));
  }
  const tests::LoopbackListener listener_, other_;
};

TEST_F(ConnectorTest, ConnectsSocketsThatWaitAndSocketsThatDoNot) {
  const auto waiting = stream();
  EXPECT_EQ(connect_to(listener_.port(), waiting.get()), 0);
  EXPECT_EQ(fcntl(waiting.get(), F_GETFL) & O_NONBLOCK, 0) << "it is as it was";
  const OwnedDescriptor accepted(listener_.accept());
  ASSERT_EQ(send(waiting.get(), "x", 1, 0), 1);
  char byte = 0;
  EXPECT_EQ(recv(accepted.get(), &byte, 1, 0), 1);

  const auto other = stream(SOCK_NONBLOCK);
  EXPECT_THAT(connect_to(listener_.port(), other.get()), ::testing::AnyOf(0, EINPROGRESS));
  pollfd on{other.get(), POLLOUT, 0};
  EXPECT_EQ(poll(&on, 1, -1), 1);
  connect_to(listener_.port(), other.get());  // which ends what has begun
  EXPECT_EQ(connect_to(listener_.port(), other.get()), EISCONN);
}

TEST_F(ConnectorTest, SaysWhatTheNetworkSays) {
  std::uint16_t closed = 0;
  {
    const tests::LoopbackListener gone;
    closed = gone.port();
  }
  start_connector({{{"127.0.0.1", closed}}, ""});
  EXPECT_EQ(connect_to(closed, stream().get()), ECONNREFUSED);
  EXPECT_EQ(connect_to(closed, -1), EBADF);
}

TEST_F(ConnectorTest, RefusesWhatIsNoPlace) {
  const auto made = stream();
  EXPECT_EQ(connect_to(other_.port(), made.get()), EACCES);
  sockaddr_storage any{};
  for (const int family : {AF_UNSPEC, AF_UNIX, AF_INET6, 999}) {
    any.ss_family = static_cast<sa_family_t>(family);
    EXPECT_EQ(connect_through(made.get(), reinterpret_cast<const sockaddr*>(&any), sizeof any), -1);
    EXPECT_EQ(errno, EACCES) << family;
  }
  EXPECT_EQ(connect_through(made.get(), reinterpret_cast<const sockaddr*>(&any), 1), -1);
  EXPECT_EQ(errno, EINVAL);
  EXPECT_EQ(connect_through(made.get(), reinterpret_cast<const sockaddr*>(&any), sizeof any + 1), -1);
  EXPECT_EQ(errno, EINVAL);
  const OwnedDescriptor datagrams(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  EXPECT_EQ(connect_to(listener_.port(), datagrams.get()), EACCES);
  const OwnedDescriptor of_ip6(socket(AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0));
  if (of_ip6) {
    EXPECT_EQ(connect_to(listener_.port(), of_ip6.get()), EACCES) << "an address of another family";
  }
  pollfd on{other_.socket(), POLLIN, 0};
  EXPECT_EQ(poll(&on, 1, 0), 0);
}

TEST_F(ConnectorTest, FindsMachinesAsGetaddrinfoDoes) {
  addrinfo hints{};
  hints.ai_family = AF_INET;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_CANONNAME;
  addrinfo* found = nullptr;
  ASSERT_EQ(find_through(&getaddrinfo, "LocalHost", "80", &hints, &found), 0);
  ASSERT_NE(found, nullptr);
  const auto expected = loopback(80);
  EXPECT_EQ(found->ai_socktype, SOCK_STREAM);
  EXPECT_EQ(found->ai_addrlen, sizeof expected);
  EXPECT_EQ(std::memcmp(found->ai_addr, &expected, sizeof expected), 0);
  EXPECT_STREQ(found->ai_canonname, "LocalHost");
  freeaddrinfo(found);
  ASSERT_EQ(find_through(&getaddrinfo, "localhost", nullptr, nullptr, &found), 0) << "with nothing said";
  freeaddrinfo(found);
  EXPECT_EQ(find_through(&getaddrinfo, "localhost", "no-such-service", &hints, &found), EAI_SERVICE);
  hints.ai_family = AF_UNIX;
  EXPECT_NE(find_through(&getaddrinfo, "localhost", "80", &hints, &found), 0);
}

TEST_F(ConnectorTest, LeavesOtherNamesToWhatThisProcessKnows) {
  const auto real = [](const char* node, const char*, const addrinfo*, addrinfo**) {
    return node == nullptr || std::string(node) == "here" ? 0 : EAI_FAIL;
  };
  addrinfo* found = nullptr;
  EXPECT_EQ(find_through(real, "here", "80", nullptr, &found), 0);
  EXPECT_EQ(find_through(real, "secret.example", "80", nullptr, &found), EAI_FAIL);
  EXPECT_EQ(find_through(real, nullptr, "80", nullptr, &found), 0);
  EXPECT_EQ(find_through(real, std::string(5000, 'a').c_str(), "80", nullptr, &found), EAI_NONAME);
}

TEST_F(ConnectorTest, ServesManyThreads) {
  std::vector<std::thread> threads;
  constexpr int count = 8;
  std::array<int, count> outcomes{};
  threads.reserve(count);
  for (int& outcome : outcomes) {
    threads.emplace_back([this, &outcome] {
      const auto made = stream(SOCK_NONBLOCK);
      addrinfo* found = nullptr;
      outcome = find_through(&getaddrinfo, "localhost", "80", nullptr, &found);
      if (outcome == 0) freeaddrinfo(found);
      const int connected = connect_to(listener_.port(), made.get());
      if (connected != 0 && connected != EINPROGRESS) outcome = connected;
    });
  }
  for (auto& thread : threads) thread.join();
  for (const int outcome : outcomes) EXPECT_EQ(outcome, 0);
}

}  // namespace
}  // namespace iotcloud::processes
