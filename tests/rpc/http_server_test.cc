#include <array>
#include <atomic>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <memory>
#include <vector>

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/tcp.h>
#include <openssl/ssl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/rpc/http/http_client.h>
#include <iotcloud/rpc/http/http_server.h>
#include <iotcloud/rpc/http/metrics_endpoint.h>
#include <iotcloud/rpc/http/page_turns.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/rpc/as_nobody.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/servers/free_port.h>

namespace iotcloud::rpc {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::AnyOf;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

/// One connection to the server.
class Client {
 public:
  Client() : fd_(socket(AF_INET, SOCK_STREAM, 0)) {}
  explicit Client(const HttpServer& server) : Client() { reach(server); }
  ~Client() { close(fd_); }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  /// Before reach(): the kernels keep little of what comes for this client.
  void take_little() const {
    const int segment = 536;
    const int buffer = 4096;
    EXPECT_EQ(setsockopt(fd_, IPPROTO_TCP, TCP_MAXSEG, &segment, sizeof segment), 0);
    EXPECT_EQ(setsockopt(fd_, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer), 0);
  }
  /// Before reach(): the client has this address of the machine.
  void come_from(const char* address) const {
    sockaddr_in from{};
    from.sin_family = AF_INET;
    EXPECT_EQ(inet_pton(AF_INET, address, &from.sin_addr), 1);
    EXPECT_EQ(bind(fd_, reinterpret_cast<const sockaddr*>(&from), sizeof from), 0);
  }
  void reach(const HttpServer& server) const {
    const std::string address = server.address();
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1))));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(fd_, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
  }
  int descriptor() const { return fd_; }
  /// \return false if the server has closed the connection
  bool say(const std::string& bytes) const {
    return send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size());
  }
  /// Whether the server has closed the connection.
  bool closed() const {
    char byte = 0;
    const ssize_t n = recv(fd_, &byte, 1, MSG_PEEK | MSG_DONTWAIT);
    return n == 0 || (n < 0 && errno != EAGAIN);
  }
  /// All that comes until the server closes the connection.
  std::string rest() const {
    std::string answer;
    char buffer[4096];
    for (ssize_t n = 0; (n = recv(fd_, buffer, sizeof buffer, 0)) > 0;)
      answer.append(buffer, static_cast<std::size_t>(n));
    return answer;
  }

 private:
  const int fd_;
};

/// As many connections as a server has.
std::vector<std::unique_ptr<Client>> all_connections(const HttpServer& server) {
  std::vector<std::unique_ptr<Client>> clients(64);
  for (auto& client : clients) client = std::make_unique<Client>(server);
  return clients;
}

/// All that comes back for these bytes until the server closes.
std::string talk(const HttpServer& server, const std::string& bytes) {
  const Client client(server);
  return client.say(bytes) ? client.rest() : "";
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

TEST(HttpServer, AnswersAProbeWhileOthersHoldAllConnectionsAndAskForNothing) {
  const HttpServer server("127.0.0.1:0", {{"/healthz", [](const HttpRequest&) { return HttpAnswer{}; }}});
  const auto silent = all_connections(server);
  for (int i = 0; i < 3; ++i) EXPECT_THAT(get(server, "/healthz"), StartsWith("HTTP/1.1 200"));
}

TEST(HttpServer, AnswersAProbeWhileOthersHoldAllConnectionsAndSendTheirRequestsInDrops) {
  const HttpServer server("127.0.0.1:0", {{"/healthz", [](const HttpRequest&) { return HttpAnswer{}; }}});
  const auto slow = all_connections(server);
  for (const char* drop : {"GET /healthz", " HTTP/1.1\r\n", "X: y\r\n"}) {
    for (const auto& client : slow) client->say(drop);
    EXPECT_THAT(get(server, "/healthz"), StartsWith("HTTP/1.1 200"));
  }
  const auto& newest = slow.back();
  EXPECT_TRUE(newest->say("Connection: close\r\n\r\n"));
  EXPECT_THAT(newest->rest(), StartsWith("HTTP/1.1 200")) << "the oldest made room";
}

TEST(HttpServer, AnswersAProbeWhileOthersHoldAllConnectionsAndDoNotReadTheirAnswers) {
  std::atomic<int> asked{0};
  const HttpServer server("127.0.0.1:0", {{"/healthz", [](const HttpRequest&) { return HttpAnswer{}; }},
                                          {"/large", [&](const HttpRequest&) {
                                             ++asked;
                                             return HttpAnswer{200, "text/plain", std::string(1 << 20, 'x')};
                                           }}});
  std::vector<std::unique_ptr<Client>> deaf;
  for (int i = 0; i < 64; ++i) {
    deaf.push_back(std::make_unique<Client>());
    deaf.back()->take_little();
    deaf.back()->reach(server);
    EXPECT_TRUE(deaf.back()->say("GET /large HTTP/1.1\r\nHost: here\r\n\r\n"));
  }
  ASSERT_TRUE(tests::eventually([&] { return asked == 64; }));
  for (int i = 0; i < 3; ++i) EXPECT_THAT(get(server, "/healthz"), StartsWith("HTTP/1.1 200"));
}

TEST(HttpServer, AFloodOfWhatIsNoHttpIsCountedAndToldOnce) {
  auto& refused = config::process_metrics().counter("iotcloud_http_refused_total", "", {{"reason", "request"}});
  const std::uint64_t refused_before = refused.value();
  const HttpServer server("127.0.0.1:0", {{"/p", [](const HttpRequest&) { return HttpAnswer{}; }}});
  const tests::CapturedLog log;
  for (int i = 0; i < 100; ++i) {
    const Client client;
    client.reach(server);
    EXPECT_TRUE(client.say("this is no HTTP\r\n\r\n"));
    EXPECT_THAT(client.rest(), testing::IsEmpty());
  }
  EXPECT_TRUE(tests::eventually([&] { return refused.value() == refused_before + 100; })) << refused.value();
  const std::string said = log.text();
  const auto first = said.find("is no HTTP");
  ASSERT_NE(first, std::string::npos) << said;
  EXPECT_EQ(said.find("is no HTTP", first + 1), std::string::npos) << said;
  EXPECT_THAT(get(server, "/p"), StartsWith("HTTP/1.1 200"));
}

#if !defined(IOTCLOUD_SANITIZED)  // the sanitizer opens a pipe to look at an object's type
TEST(HttpServer, WithoutDescriptorsItWaitsSaysSoOnceAndGoesOnWhenThereAreSome) {
  auto& refused = config::process_metrics().counter("iotcloud_http_refused_total", "", {{"reason", "accept"}});
  const std::uint64_t refused_before = refused.value();
  const HttpServer server("127.0.0.1:0", {{"/p", [](const HttpRequest&) { return HttpAnswer{}; }}});
  const Client client;
  const tests::CapturedLog log;
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  std::vector<int> taken;
  for (int fd = dup(0); fd >= 0; fd = dup(0)) {
    taken.push_back(fd);
    rlimit few = before;
    few.rlim_cur = static_cast<rlim_t>(fd) + 1;
    ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  }
  client.reach(server);
  EXPECT_TRUE(tests::eventually([&] { return refused.value() >= refused_before + 2; }));
  setrlimit(RLIMIT_NOFILE, &before);
  for (const int fd : taken) close(fd);
  EXPECT_TRUE(client.say("GET /p HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n"));
  EXPECT_THAT(client.rest(), StartsWith("HTTP/1.1 200"));
  const std::string said = log.text();
  const auto first = said.find("cannot be accepted");
  ASSERT_NE(first, std::string::npos) << said;
  EXPECT_EQ(said.find("cannot be accepted", first + 1), std::string::npos) << said;
}
#endif

TEST(HttpServer, RefusesAnAddressThatIsTakenOrNone) {
  const HttpServer server("127.0.0.1:0", {});
  EXPECT_THAT(server.address(), StartsWith("127.0.0.1:"));
  EXPECT_THROW(HttpServer(server.address(), {}), config::Error);
  EXPECT_THROW(HttpServer("nonsense", {}), config::Error);
}

/// Pages behind TLS and a token, at an address that other machines can reach.
class GuardedPages : public testing::Test {
 protected:
  static void SetUpTestSuite() { signal(SIGPIPE, SIG_IGN); }  // OpenSSL's, when a connection was cut
  GuardedPages()
      : token_(security::add_token(folder_ / "tokens", "prometheus", security::Role::viewer)),
        settings_{"0.0.0.0:0", certificates_.of("lab1"), folder_ / "tokens"} {}

  std::string read(const HttpServer& server, const HttpReader& reader) const {
    const std::string address = server.address();
    try {
      return http_get("localhost" + address.substr(address.rfind(':')), "/p", reader);
    } catch (const HttpError& e) {
      return e.what();
    }
  }

  const security::test::Certificates certificates_;
  const tests::TemporaryFolder folder_;
  const std::string token_;
  const PageSettings settings_;
  const std::map<std::string, HttpHandler> pages_{{"/p", [](const HttpRequest&) {
                                                     return HttpAnswer{200, "text/plain", "the page"};
                                                   }}};
};

TEST_F(GuardedPages, AreReadWithACertificateAndATokenOnly) {
  const HttpServer server(settings_, pages_);
  const auto certificate = certificates_.of("operator");
  EXPECT_EQ(read(server, {certificate, token_}), "the page");
  EXPECT_THAT(read(server, {certificate, ""}), HasSubstr("Authorization: Bearer"));
  EXPECT_THAT(read(server, {certificate, token_ + "0"}), HasSubstr("Authorization: Bearer"));
  EXPECT_THAT(talk(server, "GET /p HTTP/1.1\r\nHost: here\r\nAuthorization: Bearer " + token_ + "\r\n\r\n"),
              Not(HasSubstr("the page")))
      << "without TLS";
  const security::test::Certificates stranger;
  EXPECT_THAT(
      read(server, {{certificate.ca, stranger.of("operator").certificate, stranger.of("operator").key}, token_}),
      HasSubstr("does not answer"));
}

TEST_F(GuardedPages, AreNotReadWithTheTokenThatAThiefHasOfADaemonAndAnotherCertificate) {
  for (const char* caller : {"master-1", "thief"}) certificates_.authority().certify_caller(caller);
  const auto of_daemon = certificates_.of("master-1");
  const std::string token = security::add_token(settings_.tokens, "master-1", security::Role::viewer,
                                                security::subject_in(of_daemon.certificate));
  const HttpServer server(settings_, pages_);
  EXPECT_EQ(read(server, {of_daemon, token}), "the page");
  EXPECT_THAT(read(server, {certificates_.of("thief"), token}), HasSubstr("Authorization: Bearer"));
  EXPECT_EQ(read(server, {certificates_.of("thief"), token_}), "the page") << "with a token that counts with any";
}

TEST_F(GuardedPages, CountAFloodOfBrokenHandshakesAndTellItOnce) {
  auto& refused = config::process_metrics().counter("iotcloud_http_refused_total", "", {{"reason", "tls"}});
  const std::uint64_t refused_before = refused.value();
  const HttpServer server(settings_, pages_);
  const tests::CapturedLog log;
  for (int i = 0; i < 100; ++i) EXPECT_THAT(talk(server, "this is no TLS\r\n\r\n"), Not(HasSubstr("the page")));
  EXPECT_TRUE(tests::eventually([&] { return refused.value() == refused_before + 100; })) << refused.value();
  const std::string said = log.text();
  const auto first = said.find("cannot be talked to by TLS");
  ASSERT_NE(first, std::string::npos) << said;
  EXPECT_EQ(said.find("cannot be talked to by TLS", first + 1), std::string::npos) << said;
  EXPECT_EQ(read(server, {certificates_.of("operator"), token_}), "the page");
}

TEST_F(GuardedPages, AnswerAProbeWhileOthersHoldAllConnectionsAndDoNotEndTheirHandshakes) {
  const HttpServer server(settings_, pages_);
  const auto slow = all_connections(server);
  for (const auto& client : slow) EXPECT_TRUE(client->say({"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", 11}));
  for (int i = 0; i < 3; ++i) EXPECT_EQ(read(server, {certificates_.of("operator"), token_}), "the page");
  EXPECT_TRUE(tests::eventually([&] { return slow.front()->closed(); })) << "the oldest made room";
  EXPECT_FALSE(slow.back()->closed()) << "and only as many as had to";
}

TEST_F(GuardedPages, AreNotServedToOtherMachinesWithoutTlsAndTokens) {
  const auto error_of = [&](const PageSettings& settings) -> std::string {
    try {
      const HttpServer server(settings, pages_);
      return "";
    } catch (const config::Error& e) {
      return e.what();
    }
  };
  EXPECT_EQ(error_of(settings_), "");
  EXPECT_EQ(error_of({"127.0.0.1:0", {}, ""}), "");
  EXPECT_EQ(error_of({"localhost:0", {}, ""}), "");
  for (const char* everywhere : {"0.0.0.0:0", "[::]:0"}) {
    EXPECT_THAT(error_of({everywhere, {}, ""}), HasSubstr("without TLS and tokens"));
    EXPECT_THAT(error_of({everywhere, {}, settings_.tokens}), HasSubstr("without TLS"));
    EXPECT_THAT(error_of({everywhere, settings_.tls, ""}), HasSubstr("without tokens"));
  }
}

TEST_F(GuardedPages, AFloodOfTokensOfOneCertificateIsRefusedBeforeTheyAreHashedAndOthersRead) {
  certificates_.authority().certify_caller("thief");
  const std::string never_shown = security::add_token(settings_.tokens, "grafana", security::Role::viewer);
  const tests::HandClock still;  // however long it takes, nobody may try more meanwhile
  const HttpServer server(settings_, pages_, still);
  EXPECT_EQ(read(server, {certificates_.of("thief"), token_}), "the page");
  std::string refused;
  for (int i = 0; i < 20 && refused.find("too many") == std::string::npos; ++i)
    refused = read(server, {certificates_.of("thief"), token_ + "0"});
  EXPECT_THAT(refused, HasSubstr("CN=thief tries too many tokens"));
  EXPECT_EQ(read(server, {certificates_.of("operator"), never_shown}), "the page");
  EXPECT_EQ(read(server, {certificates_.of("thief"), token_}), "the page") << "what is known takes no hash";
}

TEST_F(GuardedPages, AFloodOfTokensFromAllAddressesOfLoopbackIsThatOfOneCaller) {
  const tests::HandClock still;
  const HttpServer server({"127.0.0.1:0", {}, settings_.tokens}, pages_, still);
  const auto answer_to = [&](const std::string& address) {
    const Client client;
    client.come_from(address.c_str());
    client.reach(server);
    client.say("GET /p HTTP/1.1\r\nHost: here\r\nAuthorization: Bearer " + token_ + "0\r\n\r\n");
    return client.rest();
  };
  for (int i = 1; i <= 20; ++i) EXPECT_THAT(answer_to("127.0.0." + std::to_string(i)), StartsWith("HTTP/1.1 401"));
  EXPECT_THAT(answer_to("127.0.0.21"), AllOf(StartsWith("HTTP/1.1 429"), HasSubstr("tries too many tokens")));
}

TEST(HttpServer, TheConnectionsOfOneUserOfTheMachineAreCutBeforeThoseOfOthers) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can make a socket of another user";
  const HttpServer server("127.0.0.1:0", {{"/p", [](const HttpRequest&) { return HttpAnswer{}; }}});
  const Client own(server);
  std::vector<std::unique_ptr<Client>> others;
  {
    const test::AsNobody nobody;
    others = all_connections(server);
  }
  EXPECT_TRUE(tests::eventually([&] { return others.front()->closed(); }));
  EXPECT_FALSE(own.closed());
}

TEST(PageTurns, AReaderHasAQuarterOfTheTimeWhileOthersHaveTheirs) {
  tests::HandClock clock;
  PageTurns turns(clock);
  std::chrono::milliseconds read{0};
  for (int i = 0; i < 1'000; ++i) {
    if (turns.wait("CN=busy").count() == 0) {
      turns.took("CN=busy", 9ms);
      read += 10ms;  // with what each answer costs besides its page
    }
    EXPECT_EQ(turns.wait("CN=other").count(), 0);
    clock.advance(10ms);
  }
  EXPECT_GE(read, 3'400ms) << "a second at once, and a quarter of ten";
  EXPECT_LE(read, 3'600ms);
  clock.advance(1h);
  EXPECT_EQ(turns.wait("CN=busy").count(), 0);
}

TEST(PageTurns, RemembersOnlyThoseWhoHaveAskedLately) {
  tests::HandClock clock;
  PageTurns turns(clock);
  for (int i = 0; i < 10'000; ++i) {
    turns.took(std::to_string(i), 0ms);
    clock.advance(1ms);
  }
  EXPECT_LE(turns.remembered(), 1'000u);
}

/// A connection with a certificate that is kept after each answer.
class KeptConnection {
 public:
  KeptConnection(const HttpServer& server, const security::TlsFiles& certificate, std::string token)
      : client_(server),
        context_(certificate, security::TlsContext::Side::client),
        ssl_(SSL_new(context_.get()), &SSL_free),
        token_(std::move(token)) {
    SSL_set_fd(ssl_.get(), client_.descriptor());
    EXPECT_EQ(SSL_connect(ssl_.get()), 1);
  }
  /// \return false if the connection was cut, or the page refused
  bool reads_the_page() { return asks() && answer().find("the page") != std::string::npos; }
  /// Asks for the page. \return false if the connection was cut
  bool asks() {
    const std::string request = "GET /p HTTP/1.1\r\nHost: here\r\nAuthorization: Bearer " + token_ + "\r\n\r\n";
    return SSL_write(ssl_.get(), request.data(), static_cast<int>(request.size())) > 0;
  }
  /// The page, or what comes until the connection ends instead.
  std::string answer() {
    std::string answer;
    std::array<char, 4096> buffer{};
    while (answer.find("the page") == std::string::npos) {
      const int count = SSL_read(ssl_.get(), buffer.data(), static_cast<int>(buffer.size()));
      if (count <= 0) break;
      answer.append(buffer.data(), static_cast<std::size_t>(count));
    }
    return answer;
  }

 private:
  const Client client_;
  const security::TlsContext context_;
  const std::unique_ptr<SSL, decltype(&SSL_free)> ssl_;
  const std::string token_;
};

TEST_F(GuardedPages, AreClosedToWhomATokenIsTakenFromByThemselvesAlsoOverOpenConnections) {
  const HttpServer server(settings_, pages_);
  KeptConnection stolen(server, certificates_.of("operator"), token_);
  EXPECT_TRUE(stolen.reads_the_page()) << "the attack";
  ASSERT_TRUE(security::remove_token(settings_.tokens, "prometheus"));
  EXPECT_TRUE(tests::eventually([&] { return !stolen.reads_the_page(); }));
  EXPECT_THAT(read(server, {certificates_.of("operator"), token_}), HasSubstr("Authorization: Bearer"));
}

TEST_F(GuardedPages, AreReadOverAnOpenConnectionWhileAnotherReaderHoldsAllOthersAndAsks) {
  certificates_.authority().certify_caller("thief");
  const HttpServer server(settings_, pages_);
  KeptConnection honest(server, certificates_.of("operator"), token_);
  EXPECT_TRUE(honest.reads_the_page());
  std::vector<std::unique_ptr<KeptConnection>> thief;
  for (int i = 0; i < 64; ++i) {
    thief.push_back(std::make_unique<KeptConnection>(server, certificates_.of("thief"), token_));
    EXPECT_TRUE(thief.back()->reads_the_page());
    // The server ends a connection that is idle for as long as 64 take on a busy machine.
    EXPECT_TRUE(honest.reads_the_page());
  }
  EXPECT_FALSE(thief.front()->reads_the_page()) << "it made room";
}

TEST_F(GuardedPages, AReaderWhoAsksWithoutEndIsToldToAskForLessAndOthersRead) {
  certificates_.authority().certify_caller("thief");
  tests::HandClock clock;
  const HttpServer server(settings_,
                          {{"/p",
                            [&](const HttpRequest&) {
                              clock.advance(3s);  // so long the page takes
                              return HttpAnswer{200, "text/plain", "the page"};
                            }}},
                          clock);
  KeptConnection thief(server, certificates_.of("thief"), token_);
  EXPECT_TRUE(thief.reads_the_page());
  EXPECT_TRUE(thief.asks());
  EXPECT_THAT(thief.answer(), AllOf(StartsWith("HTTP/1.1 429"), HasSubstr("CN=thief asks for too much")));
  EXPECT_EQ(read(server, {certificates_.of("operator"), token_}), "the page");
  clock.advance(1h);
  EXPECT_EQ(read(server, {certificates_.of("thief"), token_}), "the page");
}

TEST_F(GuardedPages, WaitForTheTurnOfAReaderWhoAsksOften) {
  tests::HandClock clock;
  const HttpServer server(settings_,
                          {{"/p",
                            [&](const HttpRequest&) {
                              clock.advance(1s);
                              return HttpAnswer{200, "text/plain", "the page"};
                            }}},
                          clock);
  KeptConnection reader(server, certificates_.of("operator"), token_);
  EXPECT_TRUE(reader.reads_the_page());
  EXPECT_TRUE(reader.asks());
  clock.advance(10s);
  EXPECT_THAT(reader.answer(), HasSubstr("the page"));
}

TEST_F(GuardedPages, AreClosedAtOnceToWhomATokenIsTakenFromWhenTheServerIsTold) {
  const tests::HandClock still;  // by itself the server does not look at the file again
  HttpServer server(settings_, pages_, still);
  EXPECT_EQ(read(server, {certificates_.of("operator"), token_}), "the page");
  ASSERT_TRUE(security::remove_token(settings_.tokens, "prometheus"));
  EXPECT_EQ(read(server, {certificates_.of("operator"), token_}), "the page") << "it was not told yet";
  server.reload();
  EXPECT_THAT(read(server, {certificates_.of("operator"), token_}), HasSubstr("Authorization: Bearer"));
}

TEST_F(GuardedPages, OpenConnectionsOfARevokedCertificateAreCutByThemselvesAndOthersGoOn) {
  certificates_.authority().certify_caller("thief");
  security::make_revocations(certificates_.authority());
  auto settings = settings_;
  settings.tls.revoked = security::revocations_file(certificates_.authority());
  settings.look_period = std::chrono::milliseconds(5);
  const HttpServer server(settings, pages_);
  KeptConnection stolen(server, certificates_.of("thief"), token_);
  KeptConnection honest(server, certificates_.of("operator"), token_);
  EXPECT_TRUE(stolen.reads_the_page()) << "the attack";
  EXPECT_TRUE(stolen.reads_the_page()) << "the connection is kept";
  EXPECT_TRUE(honest.reads_the_page());
  security::revoke_certificate(certificates_.authority(), "thief");
  EXPECT_TRUE(tests::eventually([&] { return !stolen.reads_the_page(); }));
  EXPECT_TRUE(honest.reads_the_page()) << "soon, as what asks nothing for a while is cut off";
  EXPECT_THAT(read(server, {certificates_.of("thief"), token_}), HasSubstr("does not answer"));
  EXPECT_TRUE(honest.reads_the_page());
}

TEST_F(GuardedPages, OpenConnectionsOfAnAuthorityThatIsTakenOutAreCutByThemselvesAndOthersGoOn) {
  const security::test::Certificates before;
  auto settings = settings_;
  settings.tls.ca = folder_ / "ca.pem";
  const std::string present = tests::read_file(certificates_.of("lab1").ca);
  tests::write_file(settings.tls.ca, tests::read_file(before.of("lab1").ca) + present);
  settings.look_period = std::chrono::milliseconds(5);
  const HttpServer server(settings, pages_);
  auto old_files = before.of("operator");
  old_files.ca = settings_.tls.ca;
  KeptConnection of_old(server, old_files, token_);
  KeptConnection of_present(server, certificates_.of("operator"), token_);
  EXPECT_TRUE(of_old.reads_the_page());
  EXPECT_TRUE(of_present.reads_the_page());
  tests::write_file(settings.tls.ca, present);
  EXPECT_TRUE(tests::eventually([&] { return !of_old.reads_the_page(); }));
  EXPECT_THAT(read(server, {old_files, token_}), HasSubstr("does not answer"));
  EXPECT_TRUE(of_present.reads_the_page());
}

TEST_F(GuardedPages, ShowARenewedCertificateByThemselvesAndKeepTheOldOneWhileTheNewIsOfNoUse) {
  security::renew_certificate(certificates_.authority(), "lab1", 3);
  auto settings = settings_;
  settings.look_period = std::chrono::milliseconds(5);
  const tests::CapturedLog log;
  const HttpServer server(settings, pages_);
  auto& days = config::process_metrics().gauge("iotcloud_certificate_days_left", "", {{"service", "pages"}});
  KeptConnection early(server, certificates_.of("operator"), token_);
  EXPECT_TRUE(tests::eventually([&] { return days.value() == 2; })) << days.value();
  EXPECT_TRUE(early.reads_the_page()) << "from time to time, as what asks nothing for a while is cut off";
  const std::string aside = folder_ / "lab1.pem";
  std::filesystem::copy_file(settings.tls.certificate, aside);
  std::ofstream(settings.tls.certificate) << "half of a cert";
  EXPECT_TRUE(tests::eventually([&] { return log.contains("go on with the certificate that they had"); }));
  EXPECT_TRUE(early.reads_the_page());
  EXPECT_EQ(read(server, {certificates_.of("operator"), token_}), "the page");
  std::filesystem::rename(aside, settings.tls.certificate);
  security::renew_certificate(certificates_.authority(), "lab1");
  EXPECT_TRUE(tests::eventually([&] { return days.value() > 700; })) << days.value();
  EXPECT_TRUE(early.reads_the_page());
  EXPECT_EQ(read(server, {certificates_.of("operator"), token_}), "the page");
  EXPECT_TRUE(early.reads_the_page());
}

TEST_F(GuardedPages, ShowTheDaysLeftOfTheirAuthorityAndOfOtherFilesThatAreNamed) {
  security::renew_certificate(certificates_.authority(), "operator", 3);
  auto settings = settings_;
  settings.certificates = {certificates_.of("operator").certificate};
  const tests::CapturedLog log;
  const HttpServer server(settings, {{"/metrics", metrics_page(config::process_metrics())}});
  const auto page = http_get("localhost" + server.address().substr(server.address().rfind(':')), "/metrics",
                             {certificates_.of("operator"), token_});
  const auto line = [](const std::string& file, const std::string& days) {
    return "iotcloud_certificate_days_left{file=\"" + file + "\",service=\"file\"} " + days;
  };
  EXPECT_THAT(page, AllOf(AnyOf(HasSubstr(line(settings.certificates[0], "2\n")),
                                HasSubstr(line(settings.certificates[0], "3\n"))),
                          HasSubstr(line(settings.tls.ca, "36"))));
  EXPECT_TRUE(log.contains(settings.certificates[0] + " expires in "));
}

TEST_F(GuardedPages, AreAskedForByTlsOnlyWhenTheyAreOnAnotherMachine) {
  EXPECT_THROW(http_get("192.0.2.1:9405", "/p"), HttpError);
  const HttpServer server(settings_, pages_);
  const std::string port = server.address().substr(server.address().rfind(':'));
  EXPECT_THROW(http_get("127.0.0.2" + port, "/p", {certificates_.of("operator"), token_}), HttpError)
      << "its certificate is not for this address";
}

TEST(HttpClient, TellsWhoDoesNotAnswerFromWhatCannotBeReadForAnotherReason) {
  const HttpServer server(PageSettings{"127.0.0.1:0", {}, ""}, {{"/p", [](const HttpRequest&) {
                                                                   return HttpAnswer{200, "text/plain", "the page"};
                                                                 }}});
  const auto fault = [](const std::string& address, const std::string& target, const HttpReader& reader = {}) {
    try {
      return http_get(address, target, reader);
    } catch (const HttpUnreachable&) {
      return std::string("unreachable");
    } catch (const HttpError& e) {
      return std::string(e.what());
    }
  };
  EXPECT_EQ(fault(server.address(), "/p"), "the page");
  EXPECT_EQ(fault("127.0.0.1:" + std::to_string(tests::free_port()), "/p"), "unreachable");
  EXPECT_THAT(fault(server.address(), "/q"), StartsWith(server.address() + "/q: "));
  EXPECT_THAT(fault(server.address(), "/p", {{}, "", 4}),
              AllOf(StartsWith(server.address()), HasSubstr("body limit exceeded")));
  EXPECT_THAT(fault("no-number:1", "/p"), HasSubstr("no-number:1 cannot be asked"));
  EXPECT_THAT(fault("127.0.0.1:1", "/p", {{"none.pem", "none.pem", "none.key"}, ""}), HasSubstr("none.pem"));
}

TEST(PageSettings, AreReadWithFileLineAndRemedy) {
  const auto error_of = [](const std::string& text) -> std::string {
    try {
      auto section = config::YamlSection::parse(text, "d.yaml");
      read_page_settings(section);
      return "";
    } catch (const config::ConfigError& e) {
      return e.what();
    }
  };
  EXPECT_EQ(error_of("metrics: {address: \"127.0.0.1:9405\"}"), "");
  EXPECT_THAT(error_of("\nmetrics: {address: \"0.0.0.0:9405\"}"),
              AllOf(StartsWith("d.yaml:2:"), HasSubstr("metrics.address"), HasSubstr("TLS and tokens"),
                    HasSubstr("iotcloud certs init"), HasSubstr("127.0.0.1")));
  EXPECT_THAT(error_of("metrics: {address: \"127.0.0.1:9405\", certificates: [/nonexistent/tunnel.pem]}"),
              AllOf(HasSubstr("metrics.certificates"), HasSubstr("tunnel.pem\" is not there")));
  EXPECT_THAT(error_of("metrics: {address: \"127.0.0.1:9405\", tokens: /nonexistent/tokens}"),
              AllOf(HasSubstr("metrics.tokens"), HasSubstr("iotcloud token add")));
}

TEST(MetricsPage, HasPrometheusText) {
  config::Metrics metrics;
  metrics.counter("frames_total", "Frames", {{"driver", "a"}}).add(3);
  metrics.histogram("t_seconds", "T").record_ns(2'000'000'000);
  const HttpServer server("127.0.0.1:0", {{"/metrics", metrics_page(metrics)}});
  EXPECT_THAT(get(server, "/metrics"), AllOf(HasSubstr("# TYPE frames_total counter"),
                                             HasSubstr("frames_total{driver=\"a\"} 3"), HasSubstr("t_seconds_count 1"),
                                             HasSubstr("t_seconds{quantile=\"0.99\"}"), HasSubstr("t_seconds_max 2")));
}

}  // namespace
}  // namespace iotcloud::rpc
