// The driver against Python's own HTTP server and client, and against raw bytes.
#include <chrono>
#include <cstdio>
#include <string>

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <linux/sockios.h>
#include <netinet/in.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/http/http_driver.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::drivers::http {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::EndsWith;
using ::testing::HasSubstr;
using testing::MockInstance;
using ::testing::StartsWith;

constexpr const char* token = "0123456789abcdef";

Descriptor http_plugin() {
  return describe<HttpDriver>("http", "test");
}

/// What the driver at an address answers to these bytes, until it closes the connection.
/// \param later what the driver gets when it has had time to read the rest
std::string ask(const std::string& address, const std::string& bytes, const std::string& later = {}) {
  const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  to.sin_port = htons(static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1))));
  EXPECT_EQ(::connect(socket, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
  EXPECT_GT(::send(socket, bytes.data(), bytes.size(), MSG_NOSIGNAL), 0);
  if (!later.empty()) {
    EXPECT_TRUE(tests::eventually([&] {
      int unread = 0;
      return ioctl(socket, SIOCOUTQ, &unread) == 0 && unread == 0;
    }));
    ::send(socket, later.data(), later.size(), MSG_NOSIGNAL);
  }
  std::string answer;
  char buffer[4096];
  for (ssize_t count; (count = recv(socket, buffer, sizeof buffer, 0)) > 0;)
    answer.append(buffer, static_cast<std::size_t>(count));
  ::close(socket);
  return answer;
}

std::string post(const std::string& target, const std::string& body, const std::string& more = {}) {
  return "POST " + target +
         " HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: " + std::to_string(body.size()) + "\r\n" + more +
         "\r\n" + body;
}

std::string property(const Message& message, const std::string& name) {
  const std::string* value = message.properties.find(name);
  return value ? *value : "-";
}

/// What a program prints.
std::string output_of(const std::string& program) {
  std::string all;
  FILE* out = popen(program.c_str(), "r");
  char buffer[4096];
  for (std::size_t count; (count = fread(buffer, 1, sizeof buffer, out)) > 0;) all.append(buffer, count);
  pclose(out);
  return all;
}

/// The device that all tests share.
tests::PrivateServer& device() {
  static tests::PrivateServer server("http_device.py");
  return server;
}

TEST(Http, makes_messages_of_webhooks) {
  MockInstance hooks(http_plugin(), {{"listen", "127.0.0.1:0"}, {"path", "/door/"}});
  ASSERT_TRUE(hooks.start()) << hooks.error();
  const std::string address = hooks.host().metadata()["listen"];
  EXPECT_THAT(
      ask(address, post("/door/front?open=1&token=x&who=me", "{\"open\": true}", "Content-Type: application/json\r\n")),
      StartsWith("HTTP/1.1 204"));
  EXPECT_THAT(ask(address, post("/window", "x")), StartsWith("HTTP/1.1 404"));
  EXPECT_THAT(ask(address, "GET /door/ HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"), StartsWith("HTTP/1.1 405"));
  const auto received = hooks.host().published("received");
  ASSERT_EQ(received.size(), 1U);
  const Message& message = received[0].message;
  EXPECT_EQ(message.payload.text(), "{\"open\": true}");
  EXPECT_EQ(property(message, "path"), "/door/front");
  EXPECT_EQ(property(message, "query"), "open=1&who=me");
  EXPECT_EQ(property(message, "content_type"), "application/json");
  EXPECT_EQ(property(message, "method"), "POST");
  EXPECT_THAT(property(message, "peer"), StartsWith("127.0.0.1:"));
}

TEST(Http, lets_senders_wait_while_its_channel_is_full) {
  MockInstance hooks(http_plugin(), {{"listen", "127.0.0.1:0"}});
  ASSERT_TRUE(hooks.open()) << hooks.error();
  const std::string address = hooks.host().metadata()["listen"];
  EXPECT_THAT(ask(address, post("/", "early")), StartsWith("HTTP/1.1 503"));
  ASSERT_TRUE(hooks.activate());
  hooks.host().answer_publish("received", PublishStatus::would_block);
  EXPECT_THAT(ask(address, post("/", "full")), AllOf(StartsWith("HTTP/1.1 503"), HasSubstr("Retry-After: 1")));
  hooks.host().answer_publish("received", PublishStatus::accepted);
  EXPECT_THAT(ask(address, post("/", "room")), StartsWith("HTTP/1.1 204"));
  EXPECT_THAT(texts(hooks, "received"), ElementsAre("room"));
}

TEST(Http, takes_webhooks_only_with_the_token) {
  const tests::TemporaryFolder folder;
  const std::string file = tests::write_file(folder / "token", std::string(token) + "\n");
  MockInstance hooks(http_plugin(), {{"listen", "127.0.0.1:0"}, {"token_file", file}});
  ASSERT_TRUE(hooks.start()) << hooks.error();
  const std::string address = hooks.host().metadata()["listen"];
  for (const std::string& wrong :
       {std::string(), std::string("Authorization: Bearer 0123456789abcdeg\r\n"),
        std::string("Authorization: ") + token + "\r\n", std::string("Authorization: Bearer \r\n")}) {
    EXPECT_THAT(ask(address, post("/", "x", wrong)), StartsWith("HTTP/1.1 401")) << wrong;
  }
  EXPECT_THAT(ask(address, post("/?token=0123456789abcde", "x")), StartsWith("HTTP/1.1 401"));
  EXPECT_TRUE(hooks.host().published("received").empty());
  EXPECT_THAT(ask(address, post("/", "x", std::string("Authorization: Bearer ") + token + "\r\n")),
              StartsWith("HTTP/1.1 204"));
  EXPECT_THAT(ask(address, post("/?a=1&token=" + std::string(token), "x")), StartsWith("HTTP/1.1 204"));
  ASSERT_EQ(hooks.host().published("received").size(), 2U);
  EXPECT_EQ(property(hooks.host().published("received")[1].message, "query"), "a=1");
}

TEST(Http, keeps_limits_whatever_comes) {
  MockInstance hooks(http_plugin(), {{"listen", "127.0.0.1:0"}, {"most_bytes", "100"}});
  ASSERT_TRUE(hooks.start()) << hooks.error();
  const std::string address = hooks.host().metadata()["listen"];
  EXPECT_THAT(ask(address, post("/", std::string(101, 'x'))), StartsWith("HTTP/1.1 413"));
  const std::string long_one = post("/", std::string(5000, 'x'));
  const std::size_t head = long_one.find("\r\n\r\n") + 4;
  EXPECT_THAT(ask(address, long_one.substr(0, head), long_one.substr(head)), StartsWith("HTTP/1.1 413"));
  const std::string chunks = "POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n";
  EXPECT_THAT(
      ask(address, chunks, "40\r\n" + std::string(64, 'x') + "\r\n40\r\n" + std::string(64, 'x') + "\r\n0\r\n\r\n"),
      StartsWith("HTTP/1.1 413"));
  EXPECT_THAT(ask(address, post("/", "x", "X: " + std::string(9000, 'x') + "\r\n")), StartsWith("HTTP/1.1 431"));
  EXPECT_THAT(ask(address, std::string("\x16\x03\x01 no HTTP\r\n\r\n")), StartsWith("HTTP/1.1 400"));
  EXPECT_THAT(ask(address, post("/", std::string(100, 'x'))), StartsWith("HTTP/1.1 204"));
  EXPECT_EQ(hooks.host().published("received").size(), 1U);
}

TEST(Http, serves_webhooks_over_tls) {
  const tests::PrivateServer has_certificates("http_device.py", {"--tls"});
  const auto file = [&](const std::string& name) { return (has_certificates.folder() / name).string(); };
  MockInstance hooks(http_plugin(),
                     {{"listen", "127.0.0.1:0"}, {"certificate", file("server.pem")}, {"key", file("server.key")}});
  ASSERT_TRUE(hooks.start()) << hooks.error();
  const std::string address = hooks.host().metadata()["listen"];
  const std::string program =
      "/usr/bin/python3 -c 'import ssl, urllib.request as r; c = ssl.create_default_context(cafile=\"" +
      file("ca.pem") + "\"); print(r.urlopen(\"https://localhost:" + address.substr(address.rfind(':') + 1) +
      "/x\", b\"secret\", context=c).status)'";
  EXPECT_EQ(output_of(program), "204\n");
  EXPECT_THAT(texts(hooks, "received"), ElementsAre("secret"));

  MockInstance calls(http_plugin(), {{"call_url", has_certificates.url()}, {"ca", file("ca.pem")}});
  ASSERT_TRUE(calls.start()) << calls.error();
  ASSERT_TRUE(calls.deliver("call", command("over TLS")));
  ASSERT_TRUE(until_published(calls, "answers", 1));
  EXPECT_THAT(texts(calls, "answers"), ElementsAre("took over TLS")) << calls.host().metadata()["connection_problem"];
  std::string other_name = has_certificates.url();
  other_name.replace(other_name.find("localhost"), 9, "127.1");  // the same address, and no name of the certificate
  for (const PropertyMap& properties : {PropertyMap{{"call_url", has_certificates.url()}},
                                        PropertyMap{{"call_url", other_name}, {"ca", file("ca.pem")}}}) {
    MockInstance distrusts(http_plugin(), properties);
    ASSERT_TRUE(distrusts.start()) << distrusts.error();
    ASSERT_TRUE(distrusts.deliver("call", command("x")));
    ASSERT_TRUE(until_published(distrusts, "answers", 1));
    EXPECT_THAT(distrusts.host().metadata()["connection_problem"], HasSubstr("certificate verify failed"));
  }
}

TEST(Http, calls_a_device_in_order_and_publishes_its_answers) {
  const tests::TemporaryFolder folder;
  MockInstance calls(http_plugin(), {{"call_url", device().url() + "/api/"},
                                     {"call_token_file", tests::write_file(folder / "token", token)}});
  ASSERT_TRUE(calls.start()) << calls.error();
  Message first = command("{\"on\": 1}");
  first.time_ms = 1234;
  Message second = command("text");
  second.properties.set("path", "/status/404");
  second.properties.set("method", "PUT");
  second.properties.set("content_type", "text/plain");
  ASSERT_TRUE(calls.deliver("call", first));
  ASSERT_TRUE(calls.deliver("call", second));
  ASSERT_TRUE(until_published(calls, "answers", 2));
  EXPECT_EQ(calls.host().metadata()["connection"], "connected");
  EXPECT_THAT(tests::read_file(device().folder() / "requests"),
              EndsWith("POST /api/ application/json Bearer 0123456789abcdef {\"on\": 1}\nPUT /api/status/404 "
                       "text/plain Bearer 0123456789abcdef text\n"));
  const auto answers = calls.host().published("answers");
  EXPECT_EQ(answers[0].message.payload.text(), "took {\"on\": 1}");
  EXPECT_EQ(answers[0].message.time_ms, 1234);
  EXPECT_EQ(property(answers[0].message, "status"), "200");
  EXPECT_EQ(property(answers[1].message, "status"), "404");
  EXPECT_EQ(property(answers[1].message, "path"), "/api/status/404");
}

TEST(Http, says_why_a_call_failed_and_which_are_lost) {
  const auto with_limit = [](const char* timeout_ms) {
    return PropertyMap{
        {"call_url", device().url()}, {"most_bytes", "1000"}, {"calls_waiting", "1"}, {"call_timeout_ms", timeout_ms}};
  };
  MockInstance calls(http_plugin(), with_limit("60000")), hasty(http_plugin(), with_limit("200"));
  ASSERT_TRUE(calls.start()) << calls.error();
  ASSERT_TRUE(hasty.start()) << hasty.error();
  const auto problem_of = [](const std::string& path, MockInstance& by) {
    by.host().forget_published();
    Message message = command("x");
    message.properties.set("path", path);
    EXPECT_TRUE(by.deliver("call", message));
    EXPECT_TRUE(until_published(by, "answers", 1));
    return property(by.host().published("answers")[0].message, "problem");
  };
  EXPECT_THAT(problem_of("/large", calls), HasSubstr("body limit"));
  EXPECT_EQ(problem_of("/small", calls), "-");
  device().pause();
  EXPECT_THAT(problem_of("/slow", hasty), HasSubstr("timeout"));
  EXPECT_EQ(hasty.host().metadata()["connection"], "away");
  calls.host().forget_published();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(calls.deliver("call", command("x")));
  EXPECT_EQ(calls.host().logged_count("others wait (calls_waiting)"), 1U);
  device().resume();
  ASSERT_TRUE(until_published(calls, "answers", 2));
  device().kill();
  EXPECT_THAT(problem_of("/gone", calls), HasSubstr("it cannot be reached: Connection refused"));
  device().start();
  EXPECT_EQ(problem_of("/back", calls), "-");
  EXPECT_EQ(calls.host().metadata()["connection"], "connected");
}

TEST(Http, says_which_property_or_message_is_wrong) {
  const auto error_with = [](const PropertyMap& properties) {
    MockInstance instance(http_plugin(), properties);
    EXPECT_FALSE(instance.open());
    return instance.error();
  };
  EXPECT_THAT(error_with({}), HasSubstr("\"listen\""));
  EXPECT_THAT(error_with({{"listen", "0.0.0.0:0"}}), HasSubstr("token_file"));
  EXPECT_THAT(error_with({{"listen", "0.0.0.0:0"}, {"token_file", "x"}}), HasSubstr("plain=true"));
  EXPECT_THAT(error_with({{"listen", "127.0.0.1:0"}, {"token_file", "/no/such"}}), HasSubstr("/no/such"));
  EXPECT_THAT(error_with({{"listen", "machine:1"}}), HasSubstr("a number, not a name"));
  EXPECT_THAT(error_with({{"listen", "127.0.0.1:0"}, {"key", "x"}}), HasSubstr("both"));
  EXPECT_THAT(error_with({{"listen", "127.0.0.1:0"}, {"certificate", "/no/such"}, {"key", "/no/such"}}),
              HasSubstr("cannot serve"));
  for (const char* url : {"ftp://a", "http://", "http://a b/", "http://a/b c", "http://a:b/"})
    EXPECT_THAT(error_with({{"call_url", url}}), HasSubstr("call_url")) << url;
  MockInstance calls(http_plugin(), {{"call_url", "http://127.0.0.1:1"}});
  ASSERT_TRUE(calls.start()) << calls.error();
  for (const auto& [name, value] :
       PropertyMap{{"path", "/a\r\nX: y"}, {"method", "EVIL\r\n"}, {"content_type", "a\r\nX: y"}}) {
    Message message = command("x");
    message.properties.set(name, value);
    ASSERT_TRUE(calls.deliver("call", message));
  }
  EXPECT_EQ(calls.host().logged_count("a call is lost"), 1U);
  MockInstance long_type(http_plugin(), {{"call_url", "http://127.0.0.1:1"}});
  ASSERT_TRUE(long_type.start()) << long_type.error();
  Message message = command("x");
  message.properties.set("content_type", std::string(70'000, 'x'));
  ASSERT_TRUE(long_type.deliver("call", message));
  EXPECT_EQ(long_type.host().logged_count("content_type has more than 1000 bytes"), 1U);
  EXPECT_THAT(error_with({{"call_url", "http://a"}, {"call_content_type", "a\nb"}}), HasSubstr("call_content_type"));
  calls.host().advance(1s);
  EXPECT_TRUE(calls.host().published("answers").empty());
}

}  // namespace
}  // namespace iotcloud::drivers::http
