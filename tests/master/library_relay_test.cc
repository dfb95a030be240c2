// What a master sends to pools of workers, and to nobody who only has a record of one: every worker may write such
// records.
#include <chrono>
#include <fstream>
#include <map>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/topology/pool/TPoolService.h"
#include <iotcloud/config/error.h>
#include <iotcloud/master/gateways/pool_client.h>
#include <iotcloud/master/pools/library_relay.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::master {
namespace {

using discovery::PoolId;
using discovery::PoolRecord;
using std::chrono::milliseconds;
using test::eventually;
using test::TestMaster;
using testing::AllOf;
using testing::HasSubstr;

const std::string library_sha256(64, 'a');

/// The Thrift service of a pool, which does what the test says. Thread safe.
class PlayedPool final : public topology::wire::TPoolServiceNull {
 public:
  /// \param piece most bytes that it gives at once
  explicit PlayedPool(std::string id, std::string library = "", std::size_t piece = 1000)
      : id_(std::move(id)), library_(std::move(library)), piece_(piece) {}

  void authenticate(discovery::wire::TResponse& answer, const std::string& token) override {
    const std::lock_guard lock(mutex_);
    token_ = token;
    answer.__set_state(discovery::wire::TResponseState::SUCCESS);
  }
  void ping(topology::wire::TPoolPing& answer) override { answer.__set_pool(id_); }
  void describeLibrary(topology::wire::TKeptLibrary& answer, const std::string&) override {
    const std::lock_guard lock(mutex_);
    asked_.push_back({std::chrono::steady_clock::now(), {}});
    answer.__set_size(static_cast<std::int64_t>(library_.size()));
  }
  void readLibrary(std::string& answer, const std::string&, std::int64_t offset) override {
    const std::lock_guard lock(mutex_);
    ++given_;
    if (!asked_.empty()) asked_.back().second = std::chrono::steady_clock::now();
    answer = library_.substr(static_cast<std::size_t>(offset), piece_);
  }
  void offerLibrary(std::string& upload, const topology::wire::TLibraryOffer&) override {
    const std::lock_guard lock(mutex_);
    sent_.clear();
    upload = "u";
  }
  void sendLibrary(const std::string&, std::int64_t, const std::string& bytes) override {
    const std::lock_guard lock(mutex_);
    sent_ += bytes;
  }
  void finishLibrary(const std::string&) override {
    const std::lock_guard lock(mutex_);
    taken_ = sent_;
  }

  std::string token() const {
    const std::lock_guard lock(mutex_);
    return token_;
  }
  /// The library that it was sent; empty: none, or not the whole.
  std::string taken() const {
    const std::lock_guard lock(mutex_);
    return taken_;
  }
  using Instant = std::chrono::steady_clock::time_point;
  /// Of each time that it was asked for the library: when that began, and when it gave the last piece.
  std::vector<std::pair<Instant, Instant>> asked() const {
    const std::lock_guard lock(mutex_);
    return asked_;
  }
  int pieces_given() const {
    const std::lock_guard lock(mutex_);
    return given_;
  }

 private:
  const std::string id_;
  const std::string library_;
  const std::size_t piece_;
  mutable std::mutex mutex_;
  std::string token_;                               ///< guarded by mutex_
  std::string sent_;                                ///< guarded by mutex_
  std::string taken_;                               ///< guarded by mutex_
  int given_ = 0;                                   ///< guarded by mutex_
  std::vector<std::pair<Instant, Instant>> asked_;  ///< guarded by mutex_
};

class LibraryRelayTest : public testing::Test {
 protected:
  LibraryRelayTest() {
    certificates_.authority().certify_host("shed", {.pools = {"p1", "p2"}});
    for (const std::string pool : {"p1", "p2"}) std::ofstream(folder_ / (pool + ".token")) << "for " << pool << "\n";
  }

  /// Serves a pool from now on. \param certificate empty: without TLS. \return its record
  PoolRecord serve(const std::string& id, const std::shared_ptr<PlayedPool>& pool,
                   const std::string& certificate = "") {
    rpc::ThriftServerOptions options;
    if (!certificate.empty()) options.tls = certificates_.of(certificate);
    services_.push_back(std::make_unique<rpc::ThriftServer>(
        options, [p = std::make_shared<topology::wire::TPoolServiceProcessor>(pool)](const auto&) { return p; }));
    PoolRecord record;
    record.id = PoolId(id);
    record.host = "127.0.0.1";
    record.port = services_.back()->port();
    record.tls = !certificate.empty();
    return record;
  }
  PoolAccess access() const { return {certificates_.of("lab1"), folder_ / "{pool}.token"}; }
  static PoolRecord with_library(PoolRecord record) {
    record.files = {library_sha256};
    return record;
  }
  /// Why the pool is not offered a library; empty: it is.
  static std::string refusal(const PoolRecord& pool, const PoolAccess& access) {
    try {
      pool_offer_library(address_of(pool, access), pool.id, {"passing.so", library_sha256, 1, ""}, test::patience);
      return "";
    } catch (const config::Error& error) {
      return error.what();
    }
  }

  const security::test::Certificates certificates_;
  const tests::TemporaryFolder folder_;
  std::vector<std::unique_ptr<rpc::ThriftServer>> services_;
};

TEST_F(LibraryRelayTest, APoolThatTheCertificateDoesNotNameSeesNeitherTokenNorLibrary) {
  // Whoever has stolen a machine has its good certificate, and as a worker writes any pool's record.
  certificates_.authority().certify_host("stolen", {.gateways = {"p1"}, .pools = {"p9"}});
  const auto thief = std::make_shared<PlayedPool>("p1");
  EXPECT_THAT(refusal(serve("p1", thief, "stolen"), access()),
              AllOf(HasSubstr("CN=stolen, not of pool p1"), HasSubstr("--pool p1")));
  EXPECT_EQ(thief->token(), "");

  const auto pool = std::make_shared<PlayedPool>("p1");
  EXPECT_EQ(refusal(serve("p1", pool, "shed"), access()), "");
  EXPECT_EQ(pool->token(), "for p1");
}

TEST_F(LibraryRelayTest, NoRecordTurnsTlsOffButForAPoolOfTheMastersOwnMachine) {
  PoolRecord record = serve("p1", std::make_shared<PlayedPool>("p1"));
  EXPECT_EQ(refusal(record, access()), "");
  for (const char* host : {"192.0.2.7", "127.0.0.1.example.org", "0.0.0.0", "::ffff:127.0.0.1", ""}) {
    record.host = host;
    EXPECT_THAT(refusal(record, access()), HasSubstr("without TLS")) << host;
  }
}

TEST_F(LibraryRelayTest, APoolThatGivesALibraryByteByByteHoldsTheOthersUpForAWhileOnly) {
  const std::string library(100'000, 'x');
  const auto slow = std::make_shared<PlayedPool>("p0", library, 1);
  const auto taker = std::make_shared<PlayedPool>("p2");
  PassLimits limits;
  limits.transfer = milliseconds{1};
  try {
    pass_library(address_of(serve("p0", slow), {}), PoolId("p0"), address_of(serve("p2", taker), {}), PoolId("p2"),
                 "passing.so", library_sha256, limits, {});
    FAIL() << "it had all the time that it wanted";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("from pool p0"));
  }
  EXPECT_EQ(taker->taken(), "");
}

/// A pool that needs a library, and those that have it.
class RelayedLibrary : public LibraryRelayTest {
 protected:
  RelayedLibrary() {
    EXPECT_TRUE(master_.leads());
    discovery::Submission submission;
    submission.name = "t"_topology;
    submission.version = {1, "yaml", {{"passing", "passing.so", library_sha256}}, ""};
    discovery::put(master_.registry(), paths_.submission("t"_topology), encode(submission));
  }
  void hold(const PoolRecord& record) {
    held_.push_back(master_.registry().hold(paths_.pool(record.id), encode(record)));
  }
  void start(const PoolAccess& access, milliseconds transfer) {
    LibraryRelay::Options options;
    options.access = access;
    options.limits.transfer = transfer;
    options.retry_pause = milliseconds{1};
    relay_.emplace(*master_, master_.registry(), std::move(options));
  }

  const discovery::Paths paths_;
  TestMaster master_{test::fresh_registry_url()};
  std::vector<discovery::GuardPtr> held_;
  std::optional<LibraryRelay> relay_;
};

TEST_F(RelayedLibrary, GetsToThePoolThatLacksItByTlsWithTheTokenOfEach) {
  const auto giver = std::make_shared<PlayedPool>("p1", std::string(2500, 'x'));
  const auto taker = std::make_shared<PlayedPool>("p2");
  hold(with_library(serve("p1", giver, "shed")));
  hold(serve("p2", taker, "shed"));
  start(access(), test::patience);
  EXPECT_TRUE(eventually([&] { return taker->taken() == std::string(2500, 'x'); }));
  EXPECT_EQ(giver->token(), "for p1");
  EXPECT_EQ(taker->token(), "for p2");
}

TEST_F(RelayedLibrary, ComesFromAnotherPoolWhenOneGivesItByteByByte) {
  const std::string library(100'000, 'x');
  const auto taker = std::make_shared<PlayedPool>("p2");
  hold(with_library(serve("p0", std::make_shared<PlayedPool>("p0", library, 1))));
  hold(with_library(serve("p1", std::make_shared<PlayedPool>("p1", library, library.size()))));
  hold(serve("p2", taker));
  start({}, milliseconds{1});
  EXPECT_TRUE(eventually([&] { return taker->taken() == library; }));
}

/// SECURITY.md: what the thief of a pool takes from others.
TEST_F(RelayedLibrary, OfAnotherTopologyWaitsForAPoolThatTakesItsTimeUntilThatIsOver) {
  const std::string other_sha256(64, 'b');
  discovery::Submission other;
  other.name = "u"_topology;
  other.version = {1, "yaml", {{"other", "other.so", other_sha256}}, ""};
  discovery::put(master_.registry(), paths_.submission(other.name), encode(other));
  const auto slow = std::make_shared<PlayedPool>("p1", std::string(100'000, 'x'), 1);
  const auto taker = std::make_shared<PlayedPool>("p3");
  auto giver = serve("p4", std::make_shared<PlayedPool>("p4", "other"));
  giver.files = {other_sha256};
  hold(with_library(serve("p1", slow)));
  hold(serve("p2", std::make_shared<PlayedPool>("p2")));
  hold(serve("p3", taker));
  hold(giver);
  start({}, std::chrono::hours{1});
  ASSERT_TRUE(eventually([&] { return slow->pieces_given() > 500; }));
  EXPECT_EQ(taker->taken(), "") << "the attack";
  start({}, milliseconds{1});
  EXPECT_TRUE(eventually([&] { return taker->taken() == "other"; }));
}

/// SECURITY.md: no more than half of the time.
TEST_F(RelayedLibrary, ThatDidNotComeInTimeLeavesAsMuchTimeToOthersAsItTook) {
  const auto slow = std::make_shared<PlayedPool>("p1", std::string(100'000, 'x'), 1);
  hold(with_library(serve("p1", slow)));
  hold(serve("p2", std::make_shared<PlayedPool>("p2")));
  constexpr milliseconds transfer{200};  // of which it is busy with all but the beginning
  start({}, transfer);
  ASSERT_TRUE(eventually([&] { return slow->asked().size() >= 3; }));
  const auto asked = slow->asked();
  for (std::size_t again = 1; again < 3; ++again) {
    const auto [began, gave_last] = asked[again - 1];
    EXPECT_GT(gave_last, began);
    EXPECT_GE(asked[again].first - gave_last, gave_last - began);
  }
}

/// SECURITY.md: the thief of a worker may make such records.
TEST_F(RelayedLibrary, ComesAfterATryForEachOfAFloodOfRecordsOfPools) {
  const auto taker = std::make_shared<PlayedPool>("p2");
  hold(with_library(serve("p1", std::make_shared<PlayedPool>("p1", "x"))));
  const auto another = std::make_shared<PlayedPool>("p0");
  PoolRecord forged = serve("p0", another);
  for (int number = 0; number < 100; ++number) {
    forged.id = PoolId(fmt::format("p0-{}", number));
    hold(forged);
  }
  hold(serve("p2", taker));
  start({}, test::patience);
  EXPECT_TRUE(eventually([&] { return taker->taken() == "x"; }));
  EXPECT_EQ(another->taken(), "") << "it answers as another pool than each record says";
}

TEST_F(RelayedLibrary, DoesNotHoldUpTheEndOfItsMaster) {
  const auto slow = std::make_shared<PlayedPool>("p1", std::string(8'000'000, 'x'), 1);
  hold(with_library(serve("p1", slow)));
  hold(serve("p2", std::make_shared<PlayedPool>("p2")));
  start({}, std::chrono::hours{1});
  ASSERT_TRUE(eventually([&] { return slow->pieces_given() > 0; }));
  relay_.reset();
}

}  // namespace
}  // namespace iotcloud::master
