// Whom a client trusts, on open connections too: handshakes in memory, with files that are replaced meanwhile.
#include "iotcloud/brokers/server_trust.h"

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openssl/ssl.h>

#include "iotcloud/tests/captured_log.h"
#include "iotcloud/tests/files.h"
#include <iotcloud/config/error.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::brokers {
namespace {

using testing::HasSubstr;

class ServerTrustTest : public testing::Test {
 protected:
  using Context = std::unique_ptr<SSL_CTX, decltype(&SSL_CTX_free)>;

  ServerTrustTest() {
    put(made_, "ca.pem");
    put_list(made_);
    trust_ = std::make_unique<ServerTrust>(file("ca.pem"), file("revoked.pem"));
  }
  std::string file(const std::string& name) const { return folder_ / name; }
  /// Replaces the authorities by this one.
  void put(const security::test::Certificates& authority, const std::string& name) const {
    std::filesystem::copy_file(authority.authority().certificate("ca"), file("new"));
    std::filesystem::rename(file("new"), file(name));
  }
  void put_list(const security::test::Certificates& authority) const {
    security::make_revocations(authority.authority());
    std::filesystem::copy_file(security::revocations_file(authority.authority()), file("new"));
    std::filesystem::rename(file("new"), file("revoked.pem"));
  }
  void revoke(const std::string& holder) const {
    security::revoke_certificate(made_.authority(), holder);
    put_list(made_);
  }
  void write_list(const std::string& text) const {
    tests::write_file(file("new"), text);
    std::filesystem::rename(file("new"), file("revoked.pem"));
  }

  /// Connects to the server "lab1". \return null: the handshake failed
  std::shared_ptr<ShownChain> connect() {
    const Context client(SSL_CTX_new(TLS_client_method()), SSL_CTX_free);
    SSL_CTX_set_verify(client.get(), SSL_VERIFY_PEER, nullptr);
    SSL_CTX_load_verify_locations(client.get(), file("ca.pem").c_str(), nullptr);
    auto shown = trust_->guard(client.get());
    const security::TlsContext server(made_.of("lab1"), security::TlsContext::Side::server);
    SSL_CTX_set_verify(server.get(), SSL_VERIFY_NONE, nullptr);
    const std::unique_ptr<SSL, decltype(&SSL_free)> here(SSL_new(client.get()), SSL_free);
    const std::unique_ptr<SSL, decltype(&SSL_free)> there(SSL_new(server.get()), SSL_free);
    BIO* mine = nullptr;
    BIO* its = nullptr;
    BIO_new_bio_pair(&mine, 0, &its, 0);
    SSL_set_bio(here.get(), mine, mine);
    SSL_set_bio(there.get(), its, its);
    SSL_set_connect_state(here.get());
    SSL_set_accept_state(there.get());
    for (int turns = 0; turns < 10; ++turns) {
      const int done = SSL_do_handshake(here.get());
      if (done != 1 && SSL_get_error(here.get(), done) != SSL_ERROR_WANT_READ) return nullptr;
      if (SSL_do_handshake(there.get()) == 1 && done == 1) return shown;
    }
    return nullptr;
  }
  /// What is said of it after looks enough for all that has been written until now.
  std::string distrust(ShownChain& shown) {
    std::string why;
    for (int looks = 0; looks < 3 && why.empty(); ++looks)
      why = trust_->distrust(shown, now_ += std::chrono::seconds(1));
    return why;
  }

  const security::test::Certificates made_;
  const tests::TemporaryFolder folder_;
  std::unique_ptr<ServerTrust> trust_;
  ServerTrust::Instant now_{};
};

TEST_F(ServerTrustTest, AServerThatIsRevokedIsNotTrustedOnOpenConnectionsNorOnNewOnes) {
  const auto shown = connect();
  ASSERT_TRUE(shown);
  EXPECT_EQ(distrust(*shown), "");
  revoke("operator");
  EXPECT_EQ(distrust(*shown), "") << "another's certificate";
  revoke("lab1");
  EXPECT_THAT(distrust(*shown), HasSubstr("has been revoked: it is on the list \"" + file("revoked.pem")));
  EXPECT_FALSE(connect());
}

TEST_F(ServerTrustTest, ARevocationBeforeTheFirstLookCountsToo) {
  const auto shown = connect();
  revoke("lab1");
  EXPECT_THAT(distrust(*shown), HasSubstr("has been revoked"));
}

TEST_F(ServerTrustTest, AnAuthorityThatIsTakenOutIsNotTrustedOnOpenConnections) {
  const auto shown = connect();
  EXPECT_EQ(distrust(*shown), "");
  const security::test::Certificates another;
  put(another, "ca.pem");
  EXPECT_THAT(distrust(*shown), HasSubstr("of no authority that is trusted any more"));
}

TEST_F(ServerTrustTest, TheSystemsAuthoritiesAreNamedWhereNoFileOfAuthoritiesIs) {
  trust_ = std::make_unique<ServerTrust>("", file("revoked.pem"));
  const auto shown = connect();
  ASSERT_TRUE(shown);
  revoke("operator");
  EXPECT_THAT(distrust(*shown), HasSubstr("there is none of it in the system's authorities now"));
}

TEST_F(ServerTrustTest, AConnectionThatWasMadeWithNewerFilesIsNotCheckedAgainstOlderOnes) {
  const security::test::Certificates another;
  put(another, "ca.pem");
  put_list(another);
  const auto early = std::make_shared<ShownChain>(0);
  EXPECT_EQ(distrust(*early), "") << "it has shown nothing";
  put(made_, "ca.pem");
  put_list(made_);
  const auto shown = connect();
  ASSERT_TRUE(shown);
  EXPECT_EQ(trust_->distrust(*shown, now_), "") << "before the next look";
  EXPECT_EQ(distrust(*shown), "");
}

TEST_F(ServerTrustTest, AListThatIsNotForItsAuthorityEndsNoOpenConnection) {
  const auto shown = connect();
  const security::test::Certificates another;
  put_list(another);
  EXPECT_EQ(distrust(*shown), "");
  EXPECT_FALSE(connect()) << "a new one is refused";
}

TEST_F(ServerTrustTest, AListThatCannotBeReadIsSaidOnceAndReadAgain) {
  const tests::CapturedLog log;
  const auto shown = connect();
  EXPECT_EQ(distrust(*shown), "");
  write_list("half of a list");
  EXPECT_EQ(distrust(*shown), "");
  EXPECT_EQ(distrust(*shown), "");
  const std::string text = log.text();
  const auto said = text.find("cannot be used");
  ASSERT_NE(said, std::string::npos) << text;
  EXPECT_EQ(text.find("cannot be used", said + 1), std::string::npos) << text;
  EXPECT_THROW(connect(), config::Error);
  revoke("lab1");
  EXPECT_THAT(distrust(*shown), HasSubstr("has been revoked"));
}

TEST_F(ServerTrustTest, FilesAreTakenOnceTwoLooksFindTheSame) {
  const auto shown = connect();
  EXPECT_EQ(distrust(*shown), "");
  const security::test::Certificates another;
  put(another, "ca.pem");
  EXPECT_EQ(trust_->distrust(*shown, now_ += std::chrono::seconds(1)), "");
  put(made_, "ca.pem");
  EXPECT_EQ(distrust(*shown), "") << "it was there for less than two looks";
}

}  // namespace
}  // namespace iotcloud::brokers
