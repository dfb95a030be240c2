// A gateway that knows its masters' keys, and somebody else who can write to the registry.
#include <gmock/gmock.h>

#include <iotcloud/config/metrics.h>
#include <iotcloud/security/signed_object.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::HasSubstr;

/// A key pair in a folder: NAME.key and NAME.pub.
class Signer {
 public:
  Signer(const std::string& folder, const std::string& name)
      : open_(tests::write_file(folder + name + ".pub", pair_.public_pem)),
        key_(private_file(folder + name + ".key", pair_.private_pem)) {}
  const std::string& public_file() const { return open_; }
  const security::ObjectSigner& key() const { return key_; }

 private:
  static std::string private_file(const std::string& path, const std::string& pem) {
    tests::write_file(path, pem);
    std::filesystem::permissions(path, std::filesystem::perms::owner_read);
    return path;
  }
  const security::KeyPair pair_ = security::new_key_pair();
  const std::string open_;
  const security::ObjectSigner key_;
};

class SignedOrders : public GatewayFixture {
 protected:
  SignedOrders() {
    security::TrustedKeys::Options trust;
    trust.require_signature = true;
    trust.trusted_keys = {master_.public_file()};
    auto with_keys = options();
    with_keys.order_keys = std::make_shared<security::TrustedKeys>(trust);
    gateway_.emplace(std::move(with_keys));
    gateway_->start();
  }
  std::string place(const std::string& instance, const std::string& gateway = "gw") const {
    return paths_.order(discovery::GatewayId(gateway), discovery::InstanceId(instance));
  }
  void write(const std::string& instance, const std::string& bytes) {
    discovery::put(*registry_, place(instance), bytes);
  }
  void give_signed(const discovery::OrderRecord& order) {
    write(order.instance, security::sign_object(master_.key(), place(order.instance), encode(order)));
  }
  static double refusals() {
    return static_cast<double>(config::process_metrics().counter("iotcloud_gateway_orders_refused_total", "").value());
  }

  const security::test::Folder folder_;
  const Signer master_{folder_ / "", "master"};
  const Signer thief_{folder_ / "", "thief"};
};

TEST_F(SignedOrders, OfATrustedMasterAreFollowedAndOthersAreRefusedSaidAndCounted) {
  const auto before = refusals();
  const std::string good = security::sign_object(master_.key(), place("a"), encode(order("a")));
  std::string tampered = good;
  tampered.replace(tampered.find("probe.so"), 8, "other.so");
  const std::vector<std::string> forged{
      encode(order("a")),
      security::sign_object(thief_.key(), place("a"), encode(order("a"))),
      security::sign_object(master_.key(), place("a", "gw2"), encode(order("a"))),
      security::sign_object(master_.key(), place("b"), encode(order("a"))),
      tampered,
      good + " ",
      "{}",
      "",
  };
  double count = before;
  for (const auto& bytes : forged) {
    write("a", bytes);
    ++count;
    EXPECT_TRUE(eventually([&] { return refusals() >= count; })) << bytes;
  }
  EXPECT_THAT(gateway_->trouble(), HasSubstr("the order for a, which no trusted master has signed"));
  EXPECT_FALSE(record("a"));
  EXPECT_TRUE(gateway_->instances().empty());

  write("a", good);
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_EQ(gateway_->trouble(), "");
  EXPECT_EQ(refusals(), count);
}

TEST_F(SignedOrders, ThatAreRefusedChangeNothingOfWhatRuns) {
  give_signed(order("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const auto before = refusals();
  auto changed = order("a");
  changed.plugin = "other.so";
  changed.epoch = 1000;
  give(changed);
  ASSERT_TRUE(eventually([&] { return refusals() > before; }));
  EXPECT_EQ(record("a")->plugin, "probe.so");
  EXPECT_EQ(record("a")->state, DriverState::active);
  EXPECT_EQ(gateway_->epoch(), 1) << "nor does a forged epoch keep the masters' next order away";
  auto stop = order("a");
  stop.active = false;
  give_signed(stop);
  EXPECT_TRUE(comes_to("a", DriverState::inactive));
}

TEST_F(SignedOrders, OfAnEarlierEpochAreOutOfDate) {
  auto late = order("a");
  late.epoch = 7;
  give_signed(late);
  ASSERT_TRUE(comes_to("a", DriverState::active));
  auto replayed = order("b");
  replayed.epoch = 6;
  give_signed(replayed);
  late.active = false;
  give_signed(late);
  ASSERT_TRUE(comes_to("a", DriverState::inactive));
  EXPECT_FALSE(record("b"));
}

}  // namespace
}  // namespace iotcloud::gateway
