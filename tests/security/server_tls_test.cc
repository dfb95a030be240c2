#include <filesystem>
#include <fstream>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/security/openssl.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/security/server_tls.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/security/slow_file.h>

namespace iotcloud::security {
namespace {

std::string content_of(const std::string& file) {
  std::ostringstream all;
  all << std::ifstream(file).rdbuf();
  return all.str();
}

TEST(ServerTls, ARevokedCertificateDoesNotComeBackByAThreadThatHasReadTheListBefore) {
  const test::Certificates made;
  const tests::TemporaryFolder folder;
  made.authority().certify_caller("thief");
  make_revocations(made.authority());
  const std::string before = content_of(revocations_file(made.authority()));
  auto files = made.of("lab1");
  files.revoked = folder / "revoked.pem";
  std::ofstream(files.revoked) << before;
  ServerTls tls("test", files);
  const ShownCertificate thief{openssl::read_certificate(made.authority().certificate("thief"))};
  EXPECT_EQ(tls.context()->distrust(thief), "");
  revoke_certificate(made.authority(), "thief");
  test::reload_around_a_change(files.revoked, before, content_of(revocations_file(made.authority())),
                               [&] { tls.reload(); });
  EXPECT_THAT(tls.context()->distrust(thief), testing::HasSubstr("revoked"));
}

}  // namespace
}  // namespace iotcloud::security
