// A gateway that knows its masters' keys, and somebody else who can write to the registry.
#include <filesystem>
#include <fstream>
#include <utility>

#include <gmock/gmock.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/freeze.h>
#include <iotcloud/security/audit_chain.h>
#include <iotcloud/security/signed_object.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/security/signer.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using security::test::Signer;
using ::testing::AllOf;
using ::testing::HasSubstr;

class SignedOrders : public GatewayFixture {
 protected:
  SignedOrders() {
    security::TrustedKeys::Options trust;
    trust.require_signature = true;
    trust.trusted_keys = {master_.public_file()};
    std::filesystem::create_directory(folder_ / "state");
    keys_ = std::make_shared<security::TrustedKeys>(trust);
    start();
  }
  void start() {
    auto with_keys = options();
    with_keys.order_keys = keys_;
    with_keys.followed_file = followed_file_;
    with_keys.audit = audit_;
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
  discovery::OrderRecord given(const std::string& instance, std::int64_t later_ms = 0) const {
    auto given = order(instance);
    given.given_ms = start_ms_ + later_ms;
    return given;
  }
  std::string removal_place(const std::string& instance, const std::string& gateway = "gw") const {
    return paths_.removal(discovery::GatewayId(gateway), discovery::InstanceId(instance));
  }
  static std::string removal(const std::string& instance, std::int64_t given_ms) {
    return encode(discovery::OrderRemoval{discovery::InstanceId(instance), 1, given_ms});
  }
  bool refuses(double count, const std::string& what) {
    return eventually([&] { return refusals() >= count && gateway_->trouble().find(what) != std::string::npos; });
  }
  static double refusals() {
    return static_cast<double>(config::process_metrics().counter("iotcloud_gateway_orders_refused_total", "").value());
  }

  const std::int64_t start_ms_ = config::system_clock().wall_ms();
  const tests::TemporaryFolder folder_;
  const std::string followed_file_ = folder_ / "state/followed-orders.jsonl";
  const Signer master_{folder_ / "", "master"};
  const Signer thief_{folder_ / "", "thief"};
  std::shared_ptr<const security::TrustedKeys> keys_;
  std::shared_ptr<security::AuditLog> audit_;
};

TEST_F(SignedOrders, ThatAreFollowedAndRefusedAreInTheChainedAuditLog) {
  gateway_.reset();
  const std::string file = folder_ / "audit.log";
  audit_ = std::make_shared<security::AuditLog>(file);
  start();
  give(given("forged"));
  ASSERT_TRUE(refuses(1, "forged"));
  give_signed(given("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  take_back("a");
  ASSERT_TRUE(refuses(2, "the removal of the order for a"));
  discovery::put(*registry_, removal_place("a"),
                 security::sign_object(master_.key(), removal_place("a"), removal("a", start_ms_ + 1)));
  ASSERT_TRUE(eventually([&] { return !record("a"); }));
  gateway_.reset();
  start();  // what was followed before is not followed anew
  give_signed(given("b"));
  ASSERT_TRUE(comes_to("b", DriverState::active));
  gateway_.reset();
  audit_.reset();
  std::vector<std::string> lines;
  std::ifstream in(file);
  bool forged = false;  // it is read again, and refused again, now and then
  for (std::string line; std::getline(in, line);) {
    if (line.find(place("forged")) == std::string::npos || !std::exchange(forged, true)) lines.push_back(line);
  }
  const auto line = [](const std::string& event, const std::string& what) {
    return AllOf(HasSubstr("\"event\":\"" + event + "\""), HasSubstr(what));
  };
  // Refusals are written a little later than orders.
  EXPECT_THAT(lines, ::testing::UnorderedElementsAre(line("refused", place("forged")), line("begun", "probe.so of a"),
                                                     line("ended", "probe.so of a"),
                                                     line("refused", "the removal of the order for a"),
                                                     line("begun", "removal of a"), line("ended", "removal of a"),
                                                     line("begun", "probe.so of b"), line("ended", "probe.so of b")));
  for (const auto& followed : lines) {
    if (followed.find("\"refused\":true") != std::string::npos) continue;
    EXPECT_THAT(followed, HasSubstr("\"who\":\"master\""));
  }
  EXPECT_TRUE(security::verify_audit({file}, {}).findings.empty());
}

TEST_F(SignedOrders, AreNotFollowedWhileTheAuditLogIsFullIfItSaysSo) {
  const std::string file = folder_ / "audit.log";
  std::filesystem::create_symlink("/dev/full", file);
  for (const bool refuse : {true, false}) {
    gateway_.reset();
    audit_.reset();
    security::AuditSettings settings{file};
    if (refuse) settings.when_full = security::AuditSettings::WhenFull::refuse;
    audit_ = std::make_shared<security::AuditLog>(settings);
    const auto before = refusals();
    start();
    if (refuse) {
      give_signed(given("a"));
      EXPECT_TRUE(refuses(before + 1, "the order for a, because it cannot be written down"));
      EXPECT_FALSE(record("a"));
    } else {
      EXPECT_TRUE(comes_to("a", DriverState::active));
    }
  }
}

TEST_F(SignedOrders, OfATrustedMasterAreFollowedAndOthersAreRefusedSaidAndCounted) {
  const auto before = refusals();
  const std::string good = security::sign_object(master_.key(), place("a"), encode(given("a")));
  std::string tampered = good;
  tampered.replace(tampered.find("probe.so"), 8, "other.so");
  const std::vector<std::string> forged{
      encode(given("a")),
      security::sign_object(thief_.key(), place("a"), encode(given("a"))),
      security::sign_object(master_.key(), place("a", "gw2"), encode(given("a"))),
      security::sign_object(master_.key(), place("b"), encode(given("a"))),
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
  give_signed(given("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const auto before = refusals();
  auto changed = given("a");
  changed.plugin = "other.so";
  changed.epoch = 1000;
  give(changed);
  ASSERT_TRUE(eventually([&] { return refusals() > before; }));
  EXPECT_EQ(record("a")->plugin, "probe.so");
  EXPECT_EQ(record("a")->state, DriverState::active);
  EXPECT_EQ(gateway_->epoch(), 1) << "nor does a forged epoch keep the masters' next order away";
  auto stop = given("a", 1);
  stop.active = false;
  give_signed(stop);
  EXPECT_TRUE(comes_to("a", DriverState::inactive));
}

TEST_F(SignedOrders, OfAnEarlierEpochAreOutOfDate) {
  auto late = given("a");
  late.epoch = 7;
  give_signed(late);
  ASSERT_TRUE(comes_to("a", DriverState::active));
  wait_until_it_has_begun();
  auto replayed = given("b");
  replayed.epoch = 6;
  give_signed(replayed);
  late.active = false;
  give_signed(late);
  ASSERT_TRUE(comes_to("a", DriverState::inactive));
  EXPECT_FALSE(record("b"));
}

TEST_F(SignedOrders, ThatWereGivenBeforeTheLastOneOrBeforeTheStartAreOutOfDate) {
  const auto first = given("a");
  auto stop = given("a", 10);
  stop.active = false;
  give_signed(first);
  ASSERT_TRUE(comes_to("a", DriverState::active));
  give_signed(stop);
  ASSERT_TRUE(comes_to("a", DriverState::inactive));
  auto before = refusals();
  give_signed(first);
  EXPECT_TRUE(refuses(before + 1, "the order for a, which is out of date"));
  EXPECT_EQ(record("a")->state, DriverState::inactive);
  before = refusals();
  give_signed(given("b", -std::chrono::milliseconds(std::chrono::hours(24)).count()));
  EXPECT_TRUE(refuses(before + 1, "is out of date"));
  EXPECT_FALSE(record("b"));
}

TEST_F(SignedOrders, TheirRemovalNeedsASignatureToo) {
  give_signed(given("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const auto since = record("a")->since_ms;
  const std::string good = removal("a", start_ms_ + 1);
  const std::vector<std::string> forged{
      "",
      good,
      security::sign_object(thief_.key(), removal_place("a"), good),
      security::sign_object(master_.key(), removal_place("a", "gw2"), good),
      security::sign_object(master_.key(), removal_place("a"), removal("b", start_ms_ + 1)),
      security::sign_object(master_.key(), removal_place("a"), removal("a", start_ms_)),  // of an earlier deployment
      security::sign_object(master_.key(), place("a"), encode(given("a"))),
  };
  for (const auto& bytes : forged) {
    const auto before = refusals();
    discovery::put(*registry_, removal_place("a"), bytes);
    take_back("a");
    EXPECT_TRUE(refuses(before + 1, "the removal of the order for a, which no trusted master has signed")) << bytes;
    give_signed(given("a"));
    EXPECT_TRUE(eventually([&] { return gateway_->trouble().empty(); })) << gateway_->trouble();
  }
  EXPECT_EQ(record("a")->state, DriverState::active);
  EXPECT_EQ(record("a")->since_ms, since) << "it ran on all the time";

  discovery::put(*registry_, removal_place("a"), security::sign_object(master_.key(), removal_place("a"), good));
  take_back("a");
  EXPECT_TRUE(eventually([&] { return !record("a"); }));
  EXPECT_TRUE(eventually([&] { return !registry_->get(removal_place("a")); })) << "it was followed";
  EXPECT_EQ(gateway_->trouble(), "");
  const auto before = refusals();
  give_signed(given("a"));
  EXPECT_TRUE(refuses(before + 1, "the order for a, which is out of date"));
  EXPECT_FALSE(record("a"));
}

TEST_F(SignedOrders, AreFollowedSoonAfterTheirMastersKeyHasComeAndNoneOfItSoonAfterItIsGone) {
  gateway_.reset();
  const std::filesystem::path keys = folder_ / "keys";
  std::filesystem::create_directory(keys);
  std::filesystem::copy_file(master_.public_file(), keys / "master.pub");
  keys_ = std::make_shared<const security::TrustedKeys>(security::TrustedKeys::Options{true, {keys}});
  start();
  const Signer second(folder_ / "", "second");
  const auto write_signed = [&](const discovery::OrderRecord& order) {
    write(order.instance, security::sign_object(second.key(), place(order.instance), encode(order)));
  };
  auto before = refusals();
  write_signed(given("a"));
  ASSERT_TRUE(refuses(before + 1, "the order for a"));
  std::filesystem::copy_file(second.public_file(), keys / "second.pub");
  ASSERT_TRUE(comes_to("a", DriverState::active));
  EXPECT_TRUE(eventually([&] { return gateway_->trouble().empty(); })) << gateway_->trouble();

  const auto trusted = keys_->generation();
  std::filesystem::remove(keys / "second.pub");
  ASSERT_TRUE(eventually([&] { return keys_->generation() != trusted; }));
  before = refusals();
  auto stop_order = given("a", 10);
  stop_order.active = false;
  write_signed(stop_order);
  EXPECT_TRUE(refuses(before + 1, "the order for a"));
  EXPECT_EQ(record("a")->state, DriverState::active) << "what runs goes on";
}

TEST_F(SignedOrders, AMasterMayEndWhatSomebodyElseRemoved) {
  give_signed(given("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const auto before = refusals();
  discovery::put(*registry_, removal_place("a"), "forged");
  take_back("a");
  ASSERT_TRUE(refuses(before + 1, "the removal of the order for a"));
  discovery::put(*registry_, removal_place("a"),
                 security::sign_object(master_.key(), removal_place("a"), removal("a", start_ms_ + 1)));
  EXPECT_TRUE(eventually([&] { return !record("a"); }));
  EXPECT_TRUE(eventually([&] { return gateway_->trouble().empty(); })) << gateway_->trouble();
}

/// The gateway stops, somebody who can write to the registry and kept old signed orders acts, and the gateway starts.
class SignedOrdersAfterARestart : public SignedOrders {
 protected:
  void stop() { gateway_.reset(); }
  void remove_signed(const std::string& instance, std::int64_t later_ms) {
    discovery::put(
        *registry_, removal_place(instance),
        security::sign_object(master_.key(), removal_place(instance), removal(instance, start_ms_ + later_ms)));
    take_back(instance);
    ASSERT_TRUE(eventually([&] { return !record(instance) && !registry_->get(removal_place(instance)); }));
  }
  /// Instance a runs, and then a later order stopped it.
  void run_and_stop_a() {
    give_signed(first_);
    ASSERT_TRUE(comes_to("a", DriverState::active));
    auto stop_order = given("a", 10);
    stop_order.active = false;
    give_signed(stop_order);
    ASSERT_TRUE(comes_to("a", DriverState::inactive));
  }
  std::string frozen_mark() const { return discovery::freeze_path(paths_, "gw"_gateway); }
  bool freezes() {
    return eventually([&] { return registry_->get(frozen_mark()).has_value(); });
  }
  void adopt(const std::string& token) {
    const auto list = paths_.orders("gw"_gateway);
    discovery::put(*registry_, list, security::sign_object(master_.key(), list, encode(discovery::Adoption{token, 1})));
  }
  std::string token() { return discovery::decode_freeze(registry_->get(frozen_mark())->data, frozen_mark()).token; }

  const discovery::OrderRecord first_ = given("a");
};

TEST_F(SignedOrdersAfterARestart, ThatWereWrittenOnceMoreAreOutOfDate) {
  run_and_stop_a();
  give_signed(given("b", 20));
  ASSERT_TRUE(comes_to("b", DriverState::active));
  stop();
  give_signed(first_);
  const auto before = refusals();
  start();
  EXPECT_TRUE(refuses(before + 1, "the order for a, which is out of date"));
  EXPECT_TRUE(comes_to("b", DriverState::active)) << "the others are followed";
  EXPECT_NE(record("a")->state, DriverState::active);
  auto again = given("a", 30);
  give_signed(again);
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_EQ(gateway_->trouble(), "");
}

TEST_F(SignedOrdersAfterARestart, ForWhatWasUndeployedAreOutOfDate) {
  give_signed(first_);
  ASSERT_TRUE(comes_to("a", DriverState::active));
  remove_signed("a", 10);
  stop();
  give_signed(first_);
  const auto before = refusals();
  start();
  EXPECT_TRUE(refuses(before + 1, "the order for a, which is out of date"));
  EXPECT_TRUE(gateway_->instances().empty());
}

TEST_F(SignedOrdersAfterARestart, OfAnInstanceThatNobodyRemembersAreOutOfDateIfLaterOnesWereFollowed) {
  give_signed(given("b"));
  ASSERT_TRUE(comes_to("b", DriverState::active));
  stop();
  give_signed(given("a", -std::chrono::milliseconds(std::chrono::minutes(11)).count()));
  give_signed(given("c", -std::chrono::milliseconds(std::chrono::minutes(9)).count()));
  const auto before = refusals();
  start();
  EXPECT_TRUE(refuses(before + 1, "the order for a, which is out of date"));
  EXPECT_TRUE(comes_to("c", DriverState::active)) << "clocks may differ by ten minutes";
}

TEST_F(SignedOrdersAfterARestart, OfARegistryThatWasPutBackWaitUntilAMasterAdoptsIt) {
  run_and_stop_a();
  stop();
  take_back("a");  // as a copy of the registry that was put back: the orders stand in other nodes
  give_signed(first_);
  start();
  ASSERT_TRUE(freezes());
  EXPECT_THAT(gateway_->trouble(), HasSubstr("the registry was put back to an earlier state: the order of a was given "
                                             "before the one that this gateway followed last"));
  EXPECT_TRUE(gateway_->instances().empty());
  adopt(token());
  EXPECT_TRUE(comes_to("a", DriverState::active));
  EXPECT_EQ(gateway_->trouble(), "");
  stop();
  start();
  EXPECT_TRUE(comes_to("a", DriverState::active)) << "what was adopted is what this gateway followed last";
}

TEST_F(SignedOrdersAfterARestart, AnAnswerToAnEarlierFreezeAdoptsNothing) {
  run_and_stop_a();
  stop();
  discovery::FreezeRecord mark;
  mark.reason = "long ago";
  mark.token = "of long ago";
  discovery::put(*registry_, frozen_mark(), encode(mark));
  adopt(mark.token);
  give_signed(first_);
  start();
  ASSERT_TRUE(eventually([&] { return token() != mark.token; }));
  EXPECT_THAT(gateway_->trouble(), HasSubstr("long ago"));
  EXPECT_TRUE(gateway_->instances().empty());
  const auto fresh = token();
  stop();
  start();
  EXPECT_EQ(token(), fresh) << "a restart does not make an answer to this freeze worthless";
  adopt(fresh);
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

TEST_F(SignedOrdersAfterARestart, AreNotFollowedIfItIsUnknownWhatWasFollowedBefore) {
  stop();
  tests::write_file(followed_file_, "{\"instance\":\n");
  EXPECT_THAT([&] { start(); }, ::testing::ThrowsMessage<config::Error>(HasSubstr("remove the file")));
  tests::write_file(followed_file_, "{\"instance\":");  // a killed process left this
  start();
  give_signed(first_);
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

TEST_F(SignedOrdersAfterARestart, AreFollowedOnceTheDiskTakesNoteOfThem) {
  stop();
  std::filesystem::rename(folder_ / "state", folder_ / "away");
  start();
  const auto before = refusals();
  give_signed(first_);
  EXPECT_TRUE(refuses(before + 1, "it cannot be written down that it is followed"));
  EXPECT_FALSE(record("a"));
  std::filesystem::rename(folder_ / "away", folder_ / "state");
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

}  // namespace
}  // namespace iotcloud::gateway
