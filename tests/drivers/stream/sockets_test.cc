#include <chrono>
#include <string>

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/tcp/tcp_driver.h>
#include <iotcloud/drivers/udp/udp_driver.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/loopback_listener.h>

namespace iotcloud::drivers {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::MockInstance;

Descriptor tcp_plugin() {
  return describe<tcp::TcpDriver>("tcp", "test");
}
Descriptor udp_plugin() {
  return describe<udp::UdpDriver>("udp", "test");
}

/// A device's socket, which blocks.
class Device {
 public:
  /// Takes a connected one.
  explicit Device(int socket) : socket_(socket) {
    const timeval limit{60, 0};
    setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
  }
  /// Connects to a driver's address.
  Device(int kind, const std::string& address) : Device(::socket(AF_INET, kind | SOCK_CLOEXEC, 0)) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    to.sin_port = htons(static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1))));
    EXPECT_EQ(::connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
  }
  ~Device() { hang_up(); }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  void write(const std::string& bytes) const {
    EXPECT_EQ(::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL), static_cast<ssize_t>(bytes.size()));
  }
  /// The next bytes; "" when the other end has hung up.
  std::string read() const {
    char buffer[1000];
    const ssize_t count = recv(socket_, buffer, sizeof buffer, 0);
    return {buffer, static_cast<std::size_t>(std::max<ssize_t>(count, 0))};
  }
  std::string address() const {
    sockaddr_in own{};
    socklen_t size = sizeof own;
    getsockname(socket_, reinterpret_cast<sockaddr*>(&own), &size);
    return "127.0.0.1:" + std::to_string(ntohs(own.sin_port));
  }
  void hang_up() {
    if (socket_ >= 0) ::close(socket_);
    socket_ = -1;
  }

 private:
  int socket_;
};

std::string at(const tests::LoopbackListener& listener, const std::string& host = "127.0.0.1") {
  return host + ":" + std::to_string(listener.port());
}

TEST(Tcp, carries_frames_both_ways_to_a_device_that_listens) {
  const tests::LoopbackListener listener;
  MockInstance plc(tcp_plugin(), {{"connect", at(listener, "localhost")}, {"framing", "length"}});
  ASSERT_TRUE(plc.start()) << plc.error();
  ASSERT_TRUE(until_metadata(plc, "connection", "connected"));
  const Device device(listener.accept());
  device.write(std::string("\0\3one\0\3two", 10));
  ASSERT_TRUE(until_published(plc, "received", 2));
  EXPECT_THAT(texts(plc, "received"), ElementsAre("one", "two"));
  ASSERT_TRUE(plc.deliver("send", command("go")));
  EXPECT_EQ(device.read(), std::string("\0\2go", 4));
}

TEST(Tcp, keeps_no_commands_for_devices_that_connect) {
  MockInstance plc(tcp_plugin(), {{"listen", "127.0.0.1:0"}, {"while_away", "keep"}});
  EXPECT_FALSE(plc.start());
  EXPECT_THAT(plc.error(), ::testing::HasSubstr("\"keep\" is for \"connect\""));
}

TEST(Tcp, connects_anew_to_a_device_that_comes_back_and_keeps_commands_for_it_when_asked) {
  const tests::LoopbackListener listener;
  MockInstance plc(tcp_plugin(), {{"connect", at(listener)}, {"while_away", "keep"}, {"unsent_bytes", "10"}});
  ASSERT_TRUE(plc.start()) << plc.error();
  ASSERT_TRUE(until_metadata(plc, "connection", "connected"));
  { const Device goes(listener.accept()); }
  ASSERT_TRUE(until_metadata(plc, "connection", "away"));
  EXPECT_EQ(plc.host().metadata()["connection_problem"], "it was closed");
  ASSERT_TRUE(plc.deliver("send", command("open")));
  ASSERT_TRUE(plc.deliver("send", command("shut")));
  ASSERT_TRUE(plc.deliver("send", command("3")));  // 10 bytes wait already
  EXPECT_EQ(plc.host().logged_count("others wait"), 1U);
  plc.host().advance(500ms);
  ASSERT_TRUE(until_metadata(plc, "connection", "connected"));
  const Device device(listener.accept());
  std::string came;
  while (came.size() < 10) came += device.read();
  EXPECT_EQ(came, "open\nshut\n");
}

TEST(Tcp, ends_a_connection_whose_stream_cannot_be_followed) {
  const tests::LoopbackListener listener;
  MockInstance plc(tcp_plugin(), {{"connect", at(listener)}, {"framing", "length"}, {"most_bytes", "100"}});
  ASSERT_TRUE(plc.start()) << plc.error();
  ASSERT_TRUE(until_metadata(plc, "connection", "connected"));
  const Device device(listener.accept());
  device.write("GET / HTTP/1.1\r\n");
  ASSERT_TRUE(until_metadata(plc, "connection", "away"));
  EXPECT_THAT(plc.host().metadata()["connection_problem"], HasSubstr("a frame with the length 18245"));
  EXPECT_EQ(device.read(), "");
}

TEST(Tcp, ends_a_connection_on_which_nothing_comes) {
  const tests::LoopbackListener listener;
  MockInstance plc(tcp_plugin(), {{"connect", at(listener)}, {"silence_ms", "400"}});
  ASSERT_TRUE(plc.start()) << plc.error();
  ASSERT_TRUE(until_metadata(plc, "connection", "connected"));
  const Device device(listener.accept());
  plc.host().advance(300ms);
  device.write("alive\n");
  ASSERT_TRUE(until_published(plc, "received", 1));
  plc.host().advance(300ms);
  EXPECT_EQ(plc.host().metadata()["connection"], "connected");
  plc.host().advance(100ms);
  EXPECT_EQ(plc.host().metadata()["connection"], "away");
}

TEST(Tcp, says_why_a_device_cannot_be_reached) {
  std::string nobody;
  {
    const tests::LoopbackListener gone;
    nobody = at(gone);
  }
  MockInstance plc(tcp_plugin(), {{"connect", nobody}});
  ASSERT_TRUE(plc.start()) << plc.error();
  ASSERT_TRUE(until_metadata(plc, "connection_problem", "cannot connect to " + nobody + ": Connection refused"));
  MockInstance nameless(tcp_plugin(), {{"connect", "no-such-machine.invalid:1"}});
  ASSERT_TRUE(nameless.start()) << nameless.error();
  ASSERT_TRUE(until(nameless, [&] {
    return nameless.host().metadata()["connection_problem"].find("no-such-machine.invalid has no address") !=
           std::string::npos;
  }));
}

TEST(Tcp, serves_devices_that_connect_and_tells_them_apart) {
  MockInstance hub(tcp_plugin(), {{"listen", "127.0.0.1:0"}, {"peers", "2"}});
  ASSERT_TRUE(hub.start()) << hub.error();
  const std::string address = hub.host().metadata()["listen"];
  ASSERT_TRUE(hub.deliver("send", command("nobody")));
  EXPECT_EQ(hub.host().logged_count("no device is connected"), 1U);
  Device first(SOCK_STREAM, address), second(SOCK_STREAM, address);
  ASSERT_TRUE(until_metadata(hub, "peers", "2"));
  const Device third(SOCK_STREAM, address);
  ASSERT_TRUE(until(hub, [&] { return hub.host().logged_count("turned away") == 1; }));
  EXPECT_EQ(third.read(), "");
  first.write("from one\n");
  ASSERT_TRUE(until_published(hub, "received", 1));
  second.write("from two\n");
  ASSERT_TRUE(until_published(hub, "received", 2));
  const auto received = hub.host().published("received");
  EXPECT_EQ(*received[0].message.properties.find("peer"), first.address());
  EXPECT_EQ(*received[1].message.properties.find("peer"), second.address());
  Message to_second = command("you");
  to_second.properties.set("peer", second.address());
  ASSERT_TRUE(hub.deliver("send", to_second));
  EXPECT_EQ(second.read(), "you\n");
  ASSERT_TRUE(hub.deliver("send", command("all")));
  EXPECT_EQ(first.read(), "all\n");
  EXPECT_EQ(second.read(), "all\n");
  second.hang_up();
  ASSERT_TRUE(until_metadata(hub, "peers", "1"));
  ASSERT_TRUE(hub.deliver("send", to_second));
  EXPECT_EQ(hub.host().metadata()["connection"], "connected");
}

TEST(Tcp, lets_devices_wait_while_it_has_no_descriptor_for_them) {
  MockInstance hub(tcp_plugin(), {{"listen", "127.0.0.1:0"}});
  ASSERT_TRUE(hub.start()) << hub.error();
  const Device waits(SOCK_STREAM, hub.host().metadata()["listen"]);
  rlimit before{};
  getrlimit(RLIMIT_NOFILE, &before);
  const int next = dup(STDIN_FILENO);
  ::close(next);
  const rlimit none{static_cast<rlim_t>(next), before.rlim_max};
  setrlimit(RLIMIT_NOFILE, &none);
  const auto called = hub.host().poll_descriptors(60s);
  const auto called_again = hub.host().poll_descriptors(0ms);
  setrlimit(RLIMIT_NOFILE, &before);
  EXPECT_EQ(called, 1U);
  EXPECT_EQ(called_again, 0U) << "it would be called again and again";
  EXPECT_EQ(hub.host().logged_count("a device has to wait"), 1U);
  hub.host().advance(100ms);
  EXPECT_TRUE(until_metadata(hub, "peers", "1"));
}

TEST(Tcp, reads_from_none_of_its_devices_while_its_channel_is_full) {
  MockInstance hub(tcp_plugin(), {{"listen", "127.0.0.1:0"}});
  ASSERT_TRUE(hub.start()) << hub.error();
  const Device first(SOCK_STREAM, hub.host().metadata()["listen"]),
      second(SOCK_STREAM, hub.host().metadata()["listen"]);
  ASSERT_TRUE(until_metadata(hub, "peers", "2"));
  hub.host().answer_publish("received", PublishStatus::would_block);
  first.write("1\n2\n");
  second.write("3\n");
  ASSERT_TRUE(until(hub, [&] { return hub.host().poll_descriptors(50ms) == 0; }));
  hub.host().answer_publish("received", PublishStatus::accepted);
  ASSERT_TRUE(hub.writable("received"));
  ASSERT_TRUE(until_published(hub, "received", 3));
  EXPECT_THAT(texts(hub, "received"), ::testing::UnorderedElementsAre("1", "2", "3"));
}

TEST(Tcp, loses_commands_that_a_device_does_not_read_and_says_so) {
  const tests::LoopbackListener listener;
  MockInstance plc(tcp_plugin(), {{"connect", at(listener)}, {"unsent_bytes", "100000"}});
  ASSERT_TRUE(plc.start()) << plc.error();
  ASSERT_TRUE(until_metadata(plc, "connection", "connected"));
  const Device device(listener.accept());
  const Message large = command(std::string(60'000, 'x'));
  ASSERT_TRUE(until(plc, [&] {
    EXPECT_TRUE(plc.deliver("send", large));
    return plc.host().logged_count("too slowly") > 0;
  }));
}

TEST(Tcp, says_which_property_is_wrong) {
  const auto error_with = [](const Descriptor& plugin, const PropertyMap& properties) {
    MockInstance instance(plugin, properties);
    EXPECT_FALSE(instance.open());
    return instance.error();
  };
  EXPECT_THAT(error_with(tcp_plugin(), {}), HasSubstr("\"connect\""));
  EXPECT_THAT(error_with(tcp_plugin(), {{"connect", "a:1"}, {"listen", "127.0.0.1:1"}}), HasSubstr("give one of"));
  EXPECT_THAT(error_with(tcp_plugin(), {{"connect", "nowhere"}}), HasSubstr("HOST:PORT"));
  EXPECT_THAT(error_with(tcp_plugin(), {{"connect", "a:70000"}}), HasSubstr("HOST:PORT"));
  EXPECT_THAT(error_with(tcp_plugin(), {{"listen", "machine:1"}}), HasSubstr("a number, not a name"));
  EXPECT_THAT(error_with(udp_plugin(), {}), HasSubstr("\"send_to\""));
  EXPECT_THAT(error_with(udp_plugin(), {{"send_to", "a:1"}, {"multicast", "239.0.0.1"}}),
              HasSubstr("needs the property \"listen\""));
}

TEST(Udp, carries_datagrams_both_ways_and_says_from_whom) {
  MockInstance hub(udp_plugin(), {{"listen", "127.0.0.1:0"}});
  ASSERT_TRUE(hub.start()) << hub.error();
  const Device device(SOCK_DGRAM, hub.host().metadata()["listen"]);
  device.write("a datagram\nwith a line");
  ASSERT_TRUE(until_published(hub, "received", 1));
  const auto received = hub.host().published("received");
  EXPECT_EQ(received[0].message.payload.text(), "a datagram\nwith a line");
  Message answer = command("answer");
  answer.properties.set("peer", *received[0].message.properties.find("peer"));
  ASSERT_TRUE(hub.deliver("send", answer));
  EXPECT_EQ(device.read(), "answer");
  ASSERT_TRUE(hub.deliver("send", command("to whom?")));
  EXPECT_EQ(hub.host().logged_count("nobody knows to whom"), 1U);
}

TEST(Udp, takes_the_frames_of_a_datagram_apart_and_refuses_what_is_left_over) {
  MockInstance hub(udp_plugin(), {{"listen", "127.0.0.1:0"}, {"framing", "delimiter"}, {"most_bytes", "10"}});
  ASSERT_TRUE(hub.start()) << hub.error();
  const Device device(SOCK_DGRAM, hub.host().metadata()["listen"]);
  device.write("one\ntwo\nre");
  device.write(std::string(11, 'x'));
  device.write("three\n");
  ASSERT_TRUE(until_published(hub, "received", 3));
  EXPECT_THAT(texts(hub, "received"), ElementsAre("one", "two", "three"));
  EXPECT_EQ(hub.host().logged_count("is not made of whole frames"), 1U);
}

TEST(Udp, sends_commands_to_its_device_and_reads_no_further_while_its_channel_is_full) {
  MockInstance device(udp_plugin(), {{"listen", "127.0.0.1:0"}});
  ASSERT_TRUE(device.start()) << device.error();
  MockInstance hub(udp_plugin(), {{"send_to", device.host().metadata()["listen"]}, {"framing", "delimiter"}});
  ASSERT_TRUE(hub.start()) << hub.error();
  ASSERT_TRUE(hub.deliver("send", command("status")));
  ASSERT_TRUE(until_published(device, "received", 1));
  Message answer = command("a\nb\n");
  answer.properties.set("peer", *device.host().published("received")[0].message.properties.find("peer"));
  hub.host().answer_publish("received", PublishStatus::would_block);
  ASSERT_TRUE(device.deliver("send", answer));
  ASSERT_GT(hub.host().poll_descriptors(60s), 0U);
  ASSERT_TRUE(device.deliver("send", answer));
  EXPECT_EQ(hub.host().poll_descriptors(20ms), 0U);
  hub.host().answer_publish("received", PublishStatus::accepted);
  ASSERT_TRUE(hub.writable("received"));
  ASSERT_TRUE(until_published(hub, "received", 4));
  EXPECT_THAT(texts(hub, "received"), ElementsAre("a", "b", "a", "b"));
}

}  // namespace
}  // namespace iotcloud::drivers
