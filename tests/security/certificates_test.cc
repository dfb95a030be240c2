#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/openssl.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::security {
namespace {

using testing::HasSubstr;

unsigned permissions(const std::string& file) {
  struct stat status {};
  EXPECT_EQ(stat(file.c_str(), &status), 0) << file;
  return status.st_mode & 0777;
}

TEST(AuthorityTest, KeysAreForTheirOwnerAndCertificatesForAll) {
  const test::Certificates made;
  for (const char* name : {"ca", "lab1", "operator"}) {
    EXPECT_EQ(permissions(made.authority().key(name)), 0600u) << name;
    EXPECT_EQ(permissions(made.authority().certificate(name)), 0644u) << name;
  }
  EXPECT_EQ(permissions(made.authority().folder), 0700u);
}

TEST(AuthorityTest, WhatItMakesCanBeUsedWhoeverItIsFor) {
  const test::Certificates made;
  for (const char* host : {"lab2.example.org", "192.0.2.7", "2001:db8::7"}) {
    made.authority().certify_host(host);
    EXPECT_NO_THROW(TlsContext(made.of(host), TlsContext::Side::server)) << host;
  }
}

TEST(AuthorityTest, NothingIsOverwritten) {
  const test::Certificates made;
  EXPECT_THROW(made.authority().make(), config::Error);
  EXPECT_THROW(made.authority().certify_host("lab1"), config::Error);
  EXPECT_THROW(made.authority().certify_caller("ca"), config::Error);
}

TEST(AuthorityTest, NamesDoNotLeaveTheFolderNorAddToTheCertificate) {
  const test::Certificates made;
  for (const char* name : {"", "..", "../x", "a/b", "lab1,DNS:lab2", "a b", "-rf"}) {
    EXPECT_THROW(made.authority().certify_host(name), config::Error) << name;
    EXPECT_THROW(made.authority().certify_caller(name), config::Error) << name;
  }
}

TEST(AuthorityTest, AGatewaysNameDoesNotAddToTheCertificate) {
  const test::Certificates made;
  for (const char* gateway : {"", "g,DNS:lab9", "a b", "../g"})
    EXPECT_THROW(made.authority().certify_host("lab2", {.gateways = {gateway}}), config::Error) << gateway;
  EXPECT_NO_THROW(made.authority().certify_host("lab2", {.gateways = {"g1", "g2"}, .pools = {"p1"}}));
  EXPECT_EQ(subject_in(made.authority().certificate("lab2")), "CN=lab2");
  EXPECT_THROW(subject_in(made.authority().key("lab2")), config::Error);
}

TEST(AuthorityTest, ADaemonsCertificateHasItsOwnNameAndItsMachinesNames) {
  const test::Certificates made;
  made.authority().certify_daemon("lab2-gateway", {"lab2", "192.0.2.7"}, {.gateways = {"g1"}});
  const auto file = made.authority().certificate("lab2-gateway");
  EXPECT_EQ(subject_in(file), "CN=lab2-gateway");
  const auto certificate = openssl::read_certificate(file);
  for (const char* host : {"lab2", "localhost"})
    EXPECT_EQ(X509_check_host(certificate.get(), host, 0, 0, nullptr), 1) << host;
  EXPECT_EQ(X509_check_ip_asc(certificate.get(), "192.0.2.7", 0), 1);
  EXPECT_EQ(X509_check_host(certificate.get(), "lab2-gateway", 0, 0, nullptr), 0) << "it is no machine";
  EXPECT_THROW(made.authority().certify_daemon("lab2-master", {"lab2,DNS:lab9"}), config::Error);
  EXPECT_THROW(made.authority().certify_daemon("a,b", {"lab2"}), config::Error);
}

TEST(AuthorityTest, WithoutAnAuthorityTheErrorSaysHowToMakeOne) {
  const tests::TemporaryFolder folder;
  try {
    Authority{folder / "none"}.certify_host("lab1");
    FAIL() << "there is no authority";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("iotcloud certs init"));
  }
}

}  // namespace
}  // namespace iotcloud::security
