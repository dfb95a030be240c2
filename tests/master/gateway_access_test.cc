// At which addresses a master calls gateways.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/gateways/gateway_access.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::master {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class MastersCalls : public testing::Test {
 protected:
  MastersCalls() {
    gateway.record.id = "lab1"_gateway;
    gateway.record.host = "lab1.example";
    gateway.record.port = 12905;
    gateway.alive = true;
    own.tls.ca = "ca.pem";
    own.tls.certificate = "master.pem";
    own.tls.key = "master.key";
  }
  std::string refusal(const GatewayAccess& access) const {
    try {
      static_cast<void>(address_of(gateway, access));
      return "";
    } catch (const config::Error& e) {
      return e.what();
    }
  }

  discovery::GatewayStatus gateway;
  GatewayAccess own;
};

TEST_F(MastersCalls, GoToNoOtherMachineInTheClearOnceItHasACertificate) {
  EXPECT_THAT(refusal(own), AllOf(HasSubstr("lab1.example speaks no TLS"), HasSubstr("thrift: {tls:")));
  EXPECT_EQ(refusal({}), "") << "without one there is no other way";
  gateway.record.tls = true;
  EXPECT_EQ(refusal(own), "");
  EXPECT_EQ(address_of(gateway, own).tls.certificate, "master.pem");
}

TEST_F(MastersCalls, GoToItsOwnMachineAndToGatewaysOfTheOriginalAsBefore) {
  gateway.record.host = "127.0.0.1";
  EXPECT_EQ(refusal(own), "");
  gateway.record.host = "lab1.example";
  gateway.original = true;
  EXPECT_EQ(refusal(own), "");
  EXPECT_TRUE(address_of(gateway, own).tls.empty());
}

}  // namespace
}  // namespace iotcloud::master
