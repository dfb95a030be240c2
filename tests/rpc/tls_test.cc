// Who gets in through TLS, and who does not.
#include <atomic>
#include <csignal>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <openssl/ssl.h>
#include <sys/socket.h>
#include <thrift/Thrift.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/rpc/service.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::rpc {
namespace {

using test::ask;
using test::client_of;
using test::RawClient;
using test::refusals;
using testing::AnyOf;
using testing::HasSubstr;

/// A client that says of TLS what the test wants, by OpenSSL alone.
class OtherClient {
 public:
  explicit OtherClient(int port) : descriptor_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(descriptor_, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    // Whatever the system's policy is: the server is to refuse.
    SSL_CTX_set_security_level(context_.get(), 0);
    SSL_CTX_set_min_proto_version(context_.get(), TLS1_VERSION);
  }
  ~OtherClient() { close(descriptor_); }
  OtherClient(const OtherClient&) = delete;
  OtherClient& operator=(const OtherClient&) = delete;

  SSL_CTX* context() { return context_.get(); }
  void show(const security::TlsFiles& files) {
    EXPECT_EQ(SSL_CTX_use_certificate_chain_file(context(), files.certificate.c_str()), 1);
    EXPECT_EQ(SSL_CTX_use_PrivateKey_file(context(), files.key.c_str(), SSL_FILETYPE_PEM), 1);
  }
  /// With TLS 1.3 a client learns only at its first answer that it was refused.
  bool is_answered() {
    const std::unique_ptr<SSL, decltype(&SSL_free)> ssl(SSL_new(context()), SSL_free);
    SSL_set_fd(ssl.get(), descriptor_);
    if (SSL_connect(ssl.get()) != 1) return false;
    const std::string call = test::call_frame("greet");
    char byte = 0;
    return SSL_write(ssl.get(), call.data(), static_cast<int>(call.size())) > 0 && SSL_read(ssl.get(), &byte, 1) == 1;
  }

 private:
  const int descriptor_;
  const std::unique_ptr<SSL_CTX, decltype(&SSL_CTX_free)> context_{SSL_CTX_new(TLS_client_method()), SSL_CTX_free};
};

/// Calls without a pause, on one connection and now and then on a new one, until a call fails.
class Caller {
 public:
  explicit Caller(const ThriftClientOptions& options)
      : thread_([this, options](const std::stop_token& stop) { call(options, stop); }) {}
  bool failed() const { return failed_; }
  /// Whether so many more calls are answered.
  bool goes_on(int calls) const {
    const int goal = answered_ + calls;
    return tests::eventually([&] { return failed_ || answered_ >= goal; }) && !failed_;
  }

 private:
  void call(const ThriftClientOptions& options, const std::stop_token& stop) {
    try {
      const ThriftClient kept(options);
      while (!stop.stop_requested()) {
        ask(kept);
        if (++answered_ % 20 == 0) ask(ThriftClient(options));
      }
    } catch (const apache::thrift::TException&) {
      failed_ = true;
    }
  }

  std::atomic<int> answered_{0};
  std::atomic<bool> failed_{false};
  std::jthread thread_;  ///< last: it uses the others
};

class Tls : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    signal(SIGPIPE, SIG_IGN);  // OtherClient's
    ours_ = std::make_unique<security::test::Certificates>();
    theirs_ = std::make_unique<security::test::Certificates>();
  }
  static void TearDownTestSuite() {
    ours_.reset();
    theirs_.reset();
  }
  Tls() {
    options_.name = testing::UnitTest::GetInstance()->current_test_info()->name();
    options_.tls = ours_->of("lab1");
    options_.look_period = std::chrono::hours(1);
  }

  void serve() {
    server_.emplace(options_, [this](const std::shared_ptr<ThriftPeer>& peer) {
      const std::lock_guard lock(mutex_);
      peer_ = peer->certificate();
      return std::make_shared<test::Greeter>();
    });
  }
  ThriftClientOptions client(const security::TlsFiles& tls, const std::string& host = "127.0.0.1") const {
    auto options = client_of(server_->port());
    options.host = host;
    options.tls = tls;
    return options;
  }
  std::string error_of(const ThriftClientOptions& options) const {
    try {
      ask(ThriftClient(options));
    } catch (const apache::thrift::TException& e) {
      return e.what();
    }
    return "";
  }
  /// Whom the last connection was with.
  std::string peer() {
    const std::lock_guard lock(mutex_);
    return peer_;
  }
  std::uint64_t refused() const { return refusals(options_.name, "tls"); }
  /// They are still served, and whatever was refused has been counted.
  void others_are_served() {
    EXPECT_EQ(ask(ThriftClient(client(ours_->of("operator")))), "hello");
    server_.reset();
  }

  static std::unique_ptr<security::test::Certificates> ours_, theirs_;
  ThriftServerOptions options_;
  std::mutex mutex_;
  std::string peer_;  ///< guarded by mutex_
  std::optional<ThriftServer> server_;
};

std::unique_ptr<security::test::Certificates> Tls::ours_, Tls::theirs_;

TEST_F(Tls, ACertificateOfTheAuthorityGetsInAndTheServerKnowsWhoseItIs) {
  serve();
  for (const char* host : {"127.0.0.1", "localhost"}) {
    const ThriftClient known(client(ours_->of("operator"), host));
    EXPECT_EQ(ask(known), "hello");
    EXPECT_EQ(peer(), "CN=operator");
    EXPECT_EQ(ask(known, "size:3000000").size(), 3'000'000u);
    EXPECT_EQ(ask(known), "hello");
  }
}

TEST_F(Tls, DaemonsMayCallEachOtherWithTheCertificatesOfTheirMachines) {
  serve();
  EXPECT_EQ(ask(ThriftClient(client(ours_->of("lab1")))), "hello");
}

TEST_F(Tls, WithoutACertificateNobodyGetsIn) {
  serve();
  EXPECT_FALSE(OtherClient(server_->port()).is_answered());
  others_are_served();
  EXPECT_EQ(refused(), 1u);
}

TEST_F(Tls, ACertificateOfAnotherAuthorityDoesNotGetIn) {
  serve();
  OtherClient other(server_->port());
  other.show(theirs_->of("operator"));
  EXPECT_FALSE(other.is_answered());
  others_are_served();
  EXPECT_EQ(refused(), 1u);
}

TEST_F(Tls, WhatIsOlderThanTls12DoesNotGetIn) {
  serve();
  for (const int version : {TLS1_VERSION, TLS1_1_VERSION}) {
    OtherClient old(server_->port());
    old.show(ours_->of("operator"));
    ASSERT_EQ(SSL_CTX_set_max_proto_version(old.context(), version), 1);
    EXPECT_FALSE(old.is_answered());
  }
  for (const int version : {TLS1_2_VERSION, TLS1_3_VERSION}) {
    OtherClient good(server_->port());
    good.show(ours_->of("operator"));
    ASSERT_EQ(SSL_CTX_set_max_proto_version(good.context(), version), 1);
    EXPECT_TRUE(good.is_answered());
  }
  others_are_served();
  EXPECT_EQ(refused(), 2u);
}

TEST_F(Tls, AClientWithoutTlsDoesNotGetIn) {
  serve();
  RawClient plain(server_->port());
  plain.send(test::call_frame("greet"));
  EXPECT_TRUE(plain.is_cut_off());
  others_are_served();
  EXPECT_EQ(refused(), 1u);
}

TEST_F(Tls, OneThatStopsInTheMiddleOfTheHandshakeIsCutOff) {
  options_.stranger_limit = std::chrono::milliseconds{100};
  serve();
  RawClient half(server_->port());
  half.send(std::string("\x16\x03\x01\x02\x00\x01", 6));  // the beginning of a hello
  EXPECT_TRUE(half.is_cut_off());
  server_.reset();
  EXPECT_EQ(refusals(options_.name, "slow"), 1u);
}

TEST_F(Tls, AFloodOfBrokenHandshakesIsCountedAndLoggedOnceAndOthersAreServed) {
  constexpr std::uint64_t flood = 40;
  serve();
  const tests::CapturedLog log;
  for (std::uint64_t i = 0; i < flood; ++i) {
    RawClient client(server_->port());
    client.send("GET / HTTP/1.1\r\n\r\n");
    EXPECT_TRUE(client.is_cut_off());
  }
  EXPECT_TRUE(tests::eventually([&] { return refused() == flood; })) << refused();
  const std::string said = log.text();
  const auto first = said.find("is cut off");
  ASSERT_NE(first, std::string::npos) << said;
  EXPECT_EQ(said.find("is cut off", first + 1), std::string::npos) << said;
  others_are_served();
}

TEST_F(Tls, AFloodOfHandshakesThatStopHalfwayTakesNobodysPlace) {
  options_.max_connections = 8;
  serve();
  std::vector<std::unique_ptr<RawClient>> half;
  for (int i = 0; i < 3 * options_.max_connections; ++i) {
    half.push_back(std::make_unique<RawClient>(server_->port()));
    half.back()->send(std::string("\x16\x03\x01\x02\x00\x01", 6));  // the beginning of a hello
  }
  const auto most = static_cast<std::uint64_t>(options_.max_connections);
  EXPECT_TRUE(tests::eventually([&] { return refusals(options_.name, "connections") >= 2 * most; }));
  EXPECT_TRUE(tests::eventually([&] { return error_of(client(ours_->of("operator"))).empty(); }));
}

TEST_F(Tls, AServerOfAnotherAuthorityIsNotSpokenWith) {
  serve();
  auto options = ours_->of("operator");
  options.ca = theirs_->of("operator").ca;
  EXPECT_THAT(error_of(client(options)), HasSubstr("certificate verify failed"));
}

TEST_F(Tls, AServerThatIsNotTheHostThatWasAskedForIsNotSpokenWith) {
  options_.host = "127.0.0.2";
  serve();
  EXPECT_THAT(error_of(client(ours_->of("operator"), "127.0.0.2")), HasSubstr("IP address mismatch"));
}

TEST_F(Tls, ACallersCertificateDoesNotMakeAServer) {
  options_.tls = ours_->of("operator");
  serve();
  EXPECT_THAT(error_of(client(ours_->of("operator"))), AnyOf(HasSubstr("purpose"), HasSubstr("certificate verify")));
}

TEST_F(Tls, AClientWithTlsIsCutOffByAServerWithoutAndSaysSo) {
  options_.tls = {};
  serve();
  EXPECT_THAT(error_of(client(ours_->of("operator"))), AnyOf(HasSubstr("closed"), HasSubstr("reset")));
}

TEST_F(Tls, AnAuthorityIsReplacedWithoutACutUntilItIsTakenOutWhichCutsWhatItHasCertified) {
  const tests::TemporaryFolder folder;
  options_.tls = {folder / "ca.pem", folder / "lab1.pem", folder / "lab1.key"};
  const auto install = [&](const std::string& authorities, const security::TlsFiles& own) {
    tests::write_file(options_.tls.ca, authorities);
    tests::write_file(options_.tls.certificate, tests::read_file(own.certificate));
    tests::write_file(options_.tls.key, tests::read_file(own.key));
  };
  const std::string old_one = tests::read_file(ours_->of("lab1").ca);
  const std::string new_one = tests::read_file(theirs_->of("lab1").ca);
  const std::string both = tests::write_file(folder / "both.pem", old_one + new_one);
  const auto caller = [&](const security::test::Certificates& of) {
    auto files = of.of("operator");
    files.ca = both;
    return client(files);
  };
  const tests::CapturedLog log;
  install(old_one, ours_->of("lab1"));
  serve();
  const ThriftClient early(caller(*ours_));
  EXPECT_EQ(ask(early), "hello");
  install(old_one + new_one, ours_->of("lab1"));
  EXPECT_NE(error_of(caller(*theirs_)), "") << "nothing is read before it is told so";
  server_->reload();
  const ThriftClient renewed(caller(*theirs_));
  EXPECT_EQ(ask(renewed), "hello");
  install(old_one + new_one, theirs_->of("lab1"));
  server_->reload();
  EXPECT_EQ(ask(ThriftClient(client(theirs_->of("operator")))), "hello") << "a new connection sees the new certificate";
  EXPECT_EQ(ask(ThriftClient(caller(*ours_))), "hello");
  EXPECT_EQ(ask(early), "hello");
  EXPECT_EQ(refusals(options_.name, "revoked"), 0u);

  install(new_one, theirs_->of("lab1"));
  server_->reload();
  ASSERT_TRUE(tests::eventually([&] { return refusals(options_.name, "revoked") == 1; }));
  EXPECT_TRUE(tests::eventually([&] { return log.contains("of an authority that is not trusted any more"); }));
  EXPECT_THROW(ask(early), apache::thrift::TException);
  EXPECT_NE(error_of(caller(*ours_)), "");
  EXPECT_EQ(ask(renewed), "hello");
  std::filesystem::remove(options_.tls.key);
  EXPECT_THROW(server_->reload(), config::Error);
  EXPECT_EQ(ask(ThriftClient(caller(*theirs_))), "hello") << "it goes on with what it had";
  EXPECT_EQ(ask(renewed), "hello");
}

TEST_F(Tls, WhileAnAuthorityIsReplacedTheRevocationsOfBothCount) {
  const security::test::Certificates before;
  const security::test::Certificates after;
  const tests::TemporaryFolder folder;
  const auto join = [&] {
    std::string authorities;
    std::string lists;
    for (const auto* made : {&before, &after}) {
      authorities += tests::read_file(made->of("lab1").ca);
      lists += tests::read_file(security::revocations_file(made->authority()));
    }
    tests::write_file(folder / "ca.pem", authorities);
    tests::write_file(folder / "revoked.pem", lists);
  };
  for (const auto* made : {&before, &after}) {
    made->authority().certify_caller("thief");
    security::make_revocations(made->authority());
  }
  join();
  options_.tls = before.of("lab1");
  options_.tls.ca = folder / "ca.pem";
  options_.tls.revoked = folder / "revoked.pem";
  serve();
  const auto caller = [&](const security::test::Certificates& of, const std::string& name) {
    auto files = of.of(name);
    files.ca = before.of("lab1").ca;
    return client(files);
  };
  const ThriftClient old_thief(caller(before, "thief"));
  const ThriftClient new_thief(caller(after, "thief"));
  EXPECT_EQ(ask(old_thief), "hello");
  EXPECT_EQ(ask(new_thief), "hello");
  std::uint64_t cut = 0;
  for (const auto* made : {&after, &before}) {
    security::revoke_certificate(made->authority(), "thief");
    join();
    server_->reload();
    ++cut;
    ASSERT_TRUE(tests::eventually([&] { return refusals(options_.name, "revoked") == cut; }));
    EXPECT_NE(error_of(caller(*made, "thief")), "");
    for (const auto* honest : {&before, &after}) EXPECT_EQ(ask(ThriftClient(caller(*honest, "operator"))), "hello");
    if (made == &after) {
      EXPECT_EQ(ask(old_thief), "hello");
    }
  }
  EXPECT_THROW(ask(old_thief), apache::thrift::TException);
  EXPECT_THROW(ask(new_thief), apache::thrift::TException);
}

TEST_F(Tls, ARevokedCertificateIsCutOffAtOnceAlsoOnAnOpenConnectionAndOthersGoOn) {
  const security::test::Certificates own;
  own.authority().certify_caller("thief");
  security::make_revocations(own.authority());
  options_.tls = own.of("lab1");
  options_.tls.revoked = security::revocations_file(own.authority());
  serve();
  const ThriftClient stolen(client(own.of("thief")));
  const ThriftClient honest(client(own.of("operator")));
  EXPECT_EQ(ask(stolen), "hello") << "the attack";
  EXPECT_EQ(ask(honest), "hello");
  security::revoke_certificate(own.authority(), "thief");
  server_->reload();
  ASSERT_TRUE(tests::eventually([&] { return refusals(options_.name, "revoked") == 1; }));
  EXPECT_THROW(ask(stolen), apache::thrift::TException);
  EXPECT_NE(error_of(client(own.of("thief"))), "");
  EXPECT_EQ(ask(honest), "hello");
  EXPECT_EQ(ask(ThriftClient(client(own.of("operator")))), "hello");
}

TEST_F(Tls, AServerWhoseCertificateIsRevokedIsNotSpokenWith) {
  const security::test::Certificates own;
  options_.tls = own.of("lab1");
  serve();
  security::make_revocations(own.authority());
  auto tls = own.of("operator");
  tls.revoked = security::revocations_file(own.authority());
  EXPECT_EQ(error_of(client(tls)), "");
  security::revoke_certificate(own.authority(), "lab1");
  EXPECT_THAT(error_of(client(tls)), HasSubstr("certificate revoked"));
}

TEST_F(Tls, UnderLoadARevokedCertificateIsCutOffAndARenewedOneShownAndNoOtherCallIsLost) {
  const security::test::Certificates own;
  own.authority().certify_caller("thief");
  security::make_revocations(own.authority());
  security::renew_certificate(own.authority(), "lab1", 3);
  options_.tls = own.of("lab1");
  options_.tls.revoked = security::revocations_file(own.authority());
  options_.look_period = std::chrono::milliseconds(20);
  serve();
  auto& days = config::process_metrics().gauge("iotcloud_certificate_days_left", "", {{"service", options_.name}});
  const Caller honest(client(own.of("operator")));
  const Caller stolen(client(own.of("thief")));
  ASSERT_TRUE(honest.goes_on(100));
  ASSERT_TRUE(stolen.goes_on(100)) << "the attack";
  security::revoke_certificate(own.authority(), "thief");
  security::renew_certificate(own.authority(), "lab1");
  ASSERT_TRUE(tests::eventually([&] { return stolen.failed() && days.value() > 700; }));
  EXPECT_NE(error_of(client(own.of("thief"))), "");
  EXPECT_TRUE(honest.goes_on(100));
}

TEST_F(Tls, ARenewedCertificateIsShownByItselfAndNoCallIsLost) {
  const security::test::Certificates own;
  security::renew_certificate(own.authority(), "lab1", 3);
  options_.tls = own.of("lab1");
  options_.look_period = std::chrono::milliseconds(20);
  serve();
  auto& days = config::process_metrics().gauge("iotcloud_certificate_days_left", "", {{"service", options_.name}});
  const ThriftClient early(client(own.of("operator")));
  EXPECT_EQ(ask(early), "hello");
  ASSERT_TRUE(tests::eventually([&] { return days.value() == 2; })) << days.value();
  security::renew_certificate(own.authority(), "lab1");
  ASSERT_TRUE(tests::eventually([&] {
    EXPECT_EQ(ask(early), "hello");
    EXPECT_EQ(ask(ThriftClient(client(own.of("operator")))), "hello");
    return days.value() > 700;
  })) << days.value();
}

TEST_F(Tls, ACertificateThatHasExpiredDoesNotGetIn) {
  const security::test::Certificates own;
  options_.tls = own.of("lab1");
  serve();
  security::renew_certificate(own.authority(), "operator", 0);  // it expires at once
  EXPECT_NE(error_of(client(own.of("operator"))), "");
}

TEST_F(Tls, FilesThatDoNotFitTogetherAreAnErrorThatNamesOne) {
  options_.tls.key = theirs_->of("lab1").key;
  try {
    serve();
    FAIL() << "the key is not the certificate's";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), HasSubstr(options_.tls.key));
  }
}

}  // namespace
}  // namespace iotcloud::rpc
