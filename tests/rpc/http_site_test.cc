#include <array>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openssl/ssl.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/rpc/http/http_client.h>
#include <iotcloud/rpc/http/http_server.h>
#include <iotcloud/rpc/http/http_site.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/rpc/raw_client.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::rpc {
namespace {

using testing::AllOf;
using testing::EndsWith;
using testing::HasSubstr;
using testing::StartsWith;
using tests::RawClient;

const PageSettings anywhere{"127.0.0.1:0", {}, ""};

std::string once(const HttpServer& server, const std::string& request) {
  RawClient client(server.address());
  client.say(request);
  return client.rest();
}

TEST(HttpSite, GetsMethodPathQueryHeadersBodyAndWhoAsks) {
  const HttpServer server(anywhere, [](const SiteRequest& request, const std::shared_ptr<HttpReply>& reply) {
    reply->answer({201,
                   "text/plain",
                   request.method + " " + request.path + " " + request.query.at("a") + " " +
                       request.headers.at("x-one") + " " + request.body +
                       (request.user == getuid() ? " mine " : " ? ") + request.address,
                   {{"X-Two", "2"}}});
  });
  const auto answer = once(server,
                           "PUT /p?a=b%20c HTTP/1.1\r\nHost: here\r\nX-One: 1\r\nConnection: close\r\n"
                           "Content-Length: 4\r\n\r\nbody");
  EXPECT_THAT(answer, AllOf(StartsWith("HTTP/1.1 201"), HasSubstr("X-Two: 2\r\n"),
                            HasSubstr("PUT /p b c 1 body mine 127.0.0.1:")));
}

TEST(HttpSite, AnswersFromAnyThreadAndServesOthersMeanwhile) {
  config::Mutex mutex;
  std::shared_ptr<HttpReply> slow;
  const HttpServer server(anywhere, [&](const SiteRequest& request, std::shared_ptr<HttpReply> reply) {
    if (request.path == "/fast") return reply->answer({200, "text/plain", "fast"});
    const config::MutexLock lock(mutex);
    slow = std::move(reply);
  });
  RawClient waiting(server.address());
  waiting.say("GET /slow HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n");
  ASSERT_TRUE(tests::eventually([&] {
    const config::MutexLock lock(mutex);
    return slow != nullptr;
  }));
  EXPECT_THAT(once(server, "GET /fast HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n"), EndsWith("fast"));
  std::thread([&] {
    const config::MutexLock lock(mutex);
    slow->answer({200, "text/plain", "slow"});
  }).join();
  EXPECT_THAT(waiting.rest(), EndsWith("slow"));
}

TEST(HttpSite, AnswersARequestThatItForgetsWith500AndOneThatItThrowsForWithTheReason) {
  const HttpServer server(anywhere, [](const SiteRequest& request, const std::shared_ptr<HttpReply>&) {
    if (request.path == "/throws") throw config::Error("the reason");
  });
  EXPECT_THAT(once(server, "GET / HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n"), StartsWith("HTTP/1.1 500"));
  EXPECT_THAT(once(server, "GET /throws HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n"), HasSubstr("the reason"));
}

TEST(HttpSite, SendsAHeadWithoutTheBodyAndRefusesALargeBody) {
  const HttpServer server(anywhere, [](const SiteRequest& request, const std::shared_ptr<HttpReply>& reply) {
    reply->answer({200, "text/plain", request.method});
  });
  EXPECT_THAT(once(server, "HEAD / HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n"),
              AllOf(HasSubstr("Content-Length: 3\r\n"), EndsWith("\r\n\r\n")));
  RawClient client(server.address());
  client.say("POST / HTTP/1.1\r\nHost: here\r\nContent-Length: 70000\r\n\r\n");
  EXPECT_EQ(client.rest(), "") << "the connection ends";
}

TEST(HttpSite, StreamsPiecesUntilItEndsTheStream) {
  std::shared_ptr<HttpStream> stream;
  config::Mutex mutex;
  const HttpServer server(anywhere, [&](const SiteRequest&, const std::shared_ptr<HttpReply>& reply) {
    const config::MutexLock lock(mutex);
    stream = reply->stream({200, "text/event-stream", "begin\n", {{"X-One", "1"}}});
  });
  RawClient client(server.address());
  client.say("GET / HTTP/1.1\r\nHost: here\r\n\r\n");
  EXPECT_THAT(client.until("begin\n"),
              AllOf(StartsWith("HTTP/1.1 200 OK"), HasSubstr("text/event-stream"), HasSubstr("X-One: 1")));
  const config::MutexLock lock(mutex);
  EXPECT_TRUE(stream->send(std::make_shared<const std::string>("one\n")));
  EXPECT_EQ(client.until("one\n"), "one\n");
  EXPECT_TRUE(stream->send(std::make_shared<const std::string>("two\n")));
  stream->end();
  EXPECT_EQ(client.rest(), "two\n");
  EXPECT_FALSE(stream->send(std::make_shared<const std::string>("three\n")));
}

TEST(HttpSite, SendsWhatAnotherThreadSendsAtOnceBehindTheBeginning) {
  const HttpServer server(anywhere, [](const SiteRequest&, const std::shared_ptr<HttpReply>& reply) {
    // The thread sends before this one has returned to its loop.
    std::jthread([stream = reply->stream({200, "text/plain", "begin\n"})] {
      stream->send(std::make_shared<const std::string>("piece\n"));
    }).join();
  });
  EXPECT_THAT(once(server, "GET / HTTP/1.1\r\nHost: here\r\n\r\n"), EndsWith("begin\npiece\n"));
}

TEST(HttpSite, TellsTheSenderThatAReaderHasGoneOrTakesNothing) {
  std::vector<std::shared_ptr<HttpStream>> streams;
  config::Mutex mutex;
  const HttpServer server(anywhere, [&](const SiteRequest&, const std::shared_ptr<HttpReply>& reply) {
    const config::MutexLock lock(mutex);
    streams.push_back(reply->stream({200, "text/plain", "begin\n"}));
  });
  auto leaves = std::make_unique<RawClient>(server.address());
  leaves->say("GET / HTTP/1.1\r\nHost: here\r\n\r\n");
  leaves->until("begin\n");
  leaves.reset();
  RawClient takes_nothing(server.address());
  takes_nothing.say("GET / HTTP/1.1\r\nHost: here\r\n\r\n");
  takes_nothing.until("begin\n");
  const auto piece = std::make_shared<const std::string>(std::string(1 << 20, 'x'));
  const config::MutexLock lock(mutex);
  ASSERT_EQ(streams.size(), 2u);
  for (const auto& stream : streams) EXPECT_TRUE(tests::eventually([&] { return !stream->send(piece); }));
}

TEST(HttpSite, MayBeAnsweredAfterItsServerHasGone) {
  std::shared_ptr<HttpReply> kept;
  std::shared_ptr<HttpStream> stream;
  config::Mutex mutex;
  auto server =
      std::make_optional<HttpServer>(anywhere, [&](const SiteRequest& request, std::shared_ptr<HttpReply> reply) {
        const config::MutexLock lock(mutex);
        if (request.path == "/stream")
          stream = reply->stream({200, "text/plain", ""});
        else
          kept = std::move(reply);
      });
  const RawClient one(server->address()), other(server->address());
  one.say("GET /stream HTTP/1.1\r\nHost: here\r\n\r\n");
  other.say("GET / HTTP/1.1\r\nHost: here\r\n\r\n");
  ASSERT_TRUE(tests::eventually([&] {
    const config::MutexLock lock(mutex);
    return kept && stream;
  }));
  server.reset();
  kept->answer({200, "text/plain", "late"});
  EXPECT_FALSE(stream->send(std::make_shared<const std::string>("late")));
}

/// What a client hears that shows no certificate.
std::string read_without_certificate(const HttpServer& server) {
  const std::unique_ptr<SSL_CTX, decltype(&SSL_CTX_free)> context(SSL_CTX_new(TLS_client_method()), &SSL_CTX_free);
  const std::unique_ptr<SSL, decltype(&SSL_free)> ssl(SSL_new(context.get()), &SSL_free);
  const RawClient client(server.address());
  SSL_set_fd(ssl.get(), client.descriptor());
  EXPECT_EQ(SSL_connect(ssl.get()), 1);
  const std::string request = "GET / HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n";
  SSL_write(ssl.get(), request.data(), static_cast<int>(request.size()));
  std::string answer;
  std::array<char, 4096> buffer{};
  for (int count = 0; (count = SSL_read(ssl.get(), buffer.data(), static_cast<int>(buffer.size()))) > 0;)
    answer.append(buffer.data(), static_cast<std::size_t>(count));
  return answer;
}

TEST(HttpSite, BehindTlsTakesBrowsersWithoutACertificateAndNoneOfAnotherAuthority) {
  security::test::Certificates certificates;
  security::test::Certificates others;
  const tests::TemporaryFolder folder;
  const std::string tokens = folder / "tokens";
  security::add_token(tokens, "anna", security::Role::viewer);
  const HttpServer server({"127.0.0.1:0", certificates.of("lab1"), tokens},
                          [](const SiteRequest& request, const std::shared_ptr<HttpReply>& reply) {
                            reply->answer({200, "text/plain", "certificate: " + request.certificate});
                          });
  EXPECT_THAT(read_without_certificate(server), EndsWith("certificate: "));
  EXPECT_THAT(http_get(server.address(), "/", {certificates.of("operator"), ""}), HasSubstr("CN=operator"));
  EXPECT_THROW(
      http_get(server.address(), "/",
               {{certificates.of("operator").ca, others.of("operator").certificate, others.of("operator").key}, ""}),
      HttpError);
  EXPECT_THROW(HttpServer({"0.0.0.0:0", {}, ""}, [](const SiteRequest&, const std::shared_ptr<HttpReply>&) {}),
               config::Error);
}

}  // namespace
}  // namespace iotcloud::rpc
