#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposition/http_server.h>
#include <iotcloud/config/exposition/metrics_endpoint.h>

namespace iotcloud::config {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

/// All that comes back for these bytes until the server closes.
std::string talk(const HttpServer& server, const std::string& bytes) {
  const std::string address = server.address();
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1))));
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const int fd = socket(AF_INET, SOCK_STREAM, 0);
  std::string answer;
  if (connect(fd, reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0 &&
      send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size())) {
    char buffer[4096];
    for (ssize_t n = 0; (n = recv(fd, buffer, sizeof buffer, 0)) > 0;)
      answer.append(buffer, static_cast<std::size_t>(n));
  }
  close(fd);
  return answer;
}

std::string get(const HttpServer& server, const std::string& target, const std::string& method = "GET") {
  return talk(server, method + " " + target + " HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n");
}

TEST(HttpServer, AnswersAPageWithItsQueryDecoded) {
  const HttpServer server("127.0.0.1:0", {{"/echo", [](const HttpRequest& request) {
                                             std::string all = request.path;
                                             for (const auto& [key, value] : request.query)
                                               all += " " + key + "=" + value;
                                             return HttpAnswer{200, "text/plain", all};
                                           }}});
  EXPECT_THAT(get(server, "/echo?a=1&b=x%20y%26z+q&c&=&d=a?b=c"),
              AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("text/plain"), HasSubstr("/echo =")));
  EXPECT_THAT(get(server, "/echo?a=1&b=x%20y%26z+q&c&d=a?b=c"), HasSubstr("/echo a=1 b=x y&z q c= d=a?b=c"));
  EXPECT_THAT(get(server, "/echo?a=%zz%2"), HasSubstr("a=%zz%2"));
  EXPECT_THAT(get(server, "/echo?"), HasSubstr("\r\n\r\n/echo"));
}

TEST(HttpServer, KeepsAConnectionForTheNextQuestion) {
  int asked = 0;
  const HttpServer server("127.0.0.1:0", {{"/n", [&](const HttpRequest&) {
                                             return HttpAnswer{200, "text/plain", "n" + std::to_string(++asked)};
                                           }}});
  const auto both =
      talk(server, "GET /n HTTP/1.1\r\nHost: h\r\n\r\nGET /n HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n");
  EXPECT_THAT(both, AllOf(HasSubstr("n1"), HasSubstr("n2")));
}

TEST(HttpServer, SaysWhatIsWrong) {
  const HttpServer server(
      "127.0.0.1:0",
      {{"/bad", [](const HttpRequest&) -> HttpAnswer { throw std::runtime_error("the page is broken"); }}});
  EXPECT_THAT(get(server, "/bad"), AllOf(StartsWith("HTTP/1.1 500"), HasSubstr("the page is broken")));
  EXPECT_THAT(get(server, "/other"), AllOf(StartsWith("HTTP/1.1 404"), HasSubstr("there are: /bad")));
  EXPECT_THAT(get(server, "/bad", "DELETE"), AllOf(StartsWith("HTTP/1.1 405"), HasSubstr("GET, HEAD")));
  EXPECT_EQ(talk(server, "GET /" + std::string(100'000, 'x') + " HTTP/1.1\r\n\r\n").find("HTTP/1.1 200"),
            std::string::npos);
  EXPECT_EQ(talk(server, "nonsense\r\n\r\n").find("HTTP/1.1 200"), std::string::npos);
  EXPECT_THAT(get(server, "/other"), StartsWith("HTTP/1.1 404")) << "it still answers";
}

TEST(HttpServer, AnswersAHeadWithoutTheBody) {
  const HttpServer server("127.0.0.1:0", {{"/p", [](const HttpRequest&) { return HttpAnswer{200, "a/b", "body"}; }}});
  EXPECT_THAT(get(server, "/p", "HEAD"), AllOf(HasSubstr("Content-Length: 4"), testing::EndsWith("\r\n\r\n")));
}

TEST(HttpServer, RefusesAnAddressThatIsTakenOrNone) {
  const HttpServer server("127.0.0.1:0", {});
  EXPECT_THAT(server.address(), StartsWith("127.0.0.1:"));
  EXPECT_THROW(HttpServer(server.address(), {}), Error);
  EXPECT_THROW(HttpServer("nonsense", {}), Error);
}

TEST(HttpServer, KnowsWhichAddressesOnlyThisMachineReaches) {
  for (const char* address : {"127.0.0.1:80", "localhost:0", "[::1]:1", "127.8.9.1:5"})
    EXPECT_TRUE(is_loopback_address(address)) << address;
  for (const char* address : {"0.0.0.0:80", "10.0.0.1:0", "[::]:1", "example.org:5", ""})
    EXPECT_FALSE(is_loopback_address(address)) << address;
}

TEST(MetricsPage, HasPrometheusText) {
  Metrics metrics;
  metrics.counter("frames_total", "Frames", {{"driver", "a"}}).add(3);
  metrics.histogram("t_seconds", "T").record_ns(2'000'000'000);
  const HttpServer server("127.0.0.1:0", {{"/metrics", metrics_page(metrics)}});
  EXPECT_THAT(get(server, "/metrics"), AllOf(HasSubstr("# TYPE frames_total counter"),
                                             HasSubstr("frames_total{driver=\"a\"} 3"), HasSubstr("t_seconds_count 1"),
                                             HasSubstr("t_seconds{quantile=\"0.99\"}"), HasSubstr("t_seconds_max 2")));
}

}  // namespace
}  // namespace iotcloud::config
