#include <cmath>
#include <filesystem>
#include <optional>

#include <gmock/gmock.h>

#include <iotcloud/security/certificate_days.h>
#include <iotcloud/security/renewals.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::security {
namespace {

using testing::AllOf;
using testing::Ge;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Le;
using testing::Optional;

std::optional<double> days_of(const config::Metrics& metrics, const std::string& broker) {
  for (const auto& sample : metrics.collect()) {
    if (sample.name != "iotcloud_certificate_days_left" || sample.labels.at("broker") != broker) continue;
    EXPECT_EQ(sample.labels.at("service"), "broker");
    return sample.value;
  }
  return std::nullopt;
}

TEST(CertificateDays, AreThoseOfTheFileAsItIsNowAndFewAreWarnedOfOnce) {
  const test::Certificates own;
  const std::string file = own.of("operator").certificate;
  config::Metrics metrics;
  const tests::CapturedLog log;
  const CertificateDays days(certificates_for_brokers({{"kafka", file}, {"rabbitmq", ""}}), metrics);
  EXPECT_GT(days_of(metrics, "kafka"), 700);
  EXPECT_EQ(days_of(metrics, "rabbitmq"), std::nullopt);
  EXPECT_THAT(log.text(), IsEmpty());

  renew_certificate(own.authority(), "operator", 3);
  EXPECT_THAT(days_of(metrics, "kafka"), Optional(AllOf(Ge(2), Le(3))));
  const std::string said = log.text();
  EXPECT_THAT(said, AllOf(HasSubstr(file), HasSubstr("kafka"), HasSubstr("expires in"), HasSubstr("certs renew")));
  EXPECT_THAT(days_of(metrics, "kafka"), Optional(AllOf(Ge(2), Le(3))));
  EXPECT_EQ(log.text(), said) << "once";

  renew_certificate(own.authority(), "operator");
  EXPECT_GT(days_of(metrics, "kafka"), 700);
  renew_certificate(own.authority(), "operator", -1);
  EXPECT_LT(days_of(metrics, "kafka"), 0);
  EXPECT_THAT(log.text(), HasSubstr("has expired"));

  std::filesystem::remove(file);
  EXPECT_EQ(days_of(metrics, "kafka"), std::nullopt);
}

TEST(CertificateDays, FewAreWarnedOfAtTheStart) {
  const test::Certificates own;
  renew_certificate(own.authority(), "operator", 3);
  config::Metrics metrics;
  const tests::CapturedLog log;
  const CertificateDays days(certificates_for_brokers({{"kafka", own.of("operator").certificate}}), metrics);
  EXPECT_THAT(log.text(), HasSubstr("expires in"));
}

}  // namespace
}  // namespace iotcloud::security
