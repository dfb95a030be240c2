// The order in which a gateway hears of its orders, told step by step by a registry that the test controls.
#include <filesystem>
#include <functional>
#include <future>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/order_feed.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/security/signer.h>

namespace iotcloud::gateway {
namespace {

using discovery::Node;
using discovery::SessionState;
using testing::ElementsAre;
using Names = std::vector<std::string>;
using namespace std::chrono_literals;

/// Reads tell what stands in `nodes`. Watches tell what the test says, and when.
class ToldRegistry final : public discovery::Registry {
 public:
  std::map<std::string, Node> nodes;  ///< by path
  std::function<void(const std::optional<Names>&)> tell_names;
  std::map<std::string, std::function<void(const std::optional<Node>&)>> tell_node;  ///< by path
  std::function<void(SessionState)> tell_session;
  std::function<void()> before_names;  ///< called once, before names are read
  std::string unanswered;              ///< the names below this path cannot be read
  std::map<std::string, int> read;     ///< how often names below a path were read

  std::optional<Node> get(const std::string& path) override {
    const auto found = nodes.find(path);
    return found == nodes.end() ? std::nullopt : std::optional(found->second);
  }
  std::optional<Names> children(const std::string& path) override {
    if (const auto call = std::exchange(before_names, nullptr)) call();
    ++read[path];
    if (path == unanswered) throw discovery::RegistryError(discovery::RegistryErrorCode::away, path);
    Names names;
    for (const auto& [child, node] : nodes) {
      if (child.starts_with(path + "/")) names.push_back(child.substr(path.size() + 1));
    }
    if (!nodes.contains(path)) return std::nullopt;
    return names;
  }
  std::vector<std::optional<Node>> get_all(const Names& paths) override {
    std::vector<std::optional<Node>> all;
    for (const auto& path : paths) all.push_back(get(path));
    return all;
  }
  discovery::GuardPtr watch_node(const std::string& path,
                                 std::function<void(const std::optional<Node>&)> callback) override {
    tell_node[path] = std::move(callback);
    return nullptr;
  }
  discovery::GuardPtr watch_children(const std::string&,
                                     std::function<void(const std::optional<Names>&)> callback) override {
    tell_names = std::move(callback);
    return nullptr;
  }
  discovery::GuardPtr on_session(std::function<void(SessionState)> callback) override {
    tell_session = std::move(callback);
    return nullptr;
  }
  SessionState session() const override { return SessionState::connected; }

  void create(const std::string& path, const std::string& data, bool, const discovery::Fence&) override {
    nodes[path] = Node{.data = data, .version = 0, .created = 1000};
  }
  void set(const std::string& path, const std::string& data, std::int64_t, const discovery::Fence&) override {
    if (!nodes.contains(path)) throw discovery::RegistryError(discovery::RegistryErrorCode::no_node, path);
    nodes[path].data = data;
    ++nodes[path].version;
  }
  bool remove(const std::string& path, std::int64_t, const discovery::Fence&) override { return nodes.erase(path) > 0; }
  // What a feed does not do.
  std::vector<std::optional<Names>> children_of_all(const Names&) override { throw std::logic_error("children"); }
  discovery::GuardPtr hold(const std::string&, const std::string&, bool,
                           std::function<void(const std::string&)>) override {
    throw std::logic_error("hold");
  }
  discovery::GuardPtr hold_eventually(const std::string&, const std::string&, bool,
                                      std::function<void(const std::string&)>) override {
    throw std::logic_error("hold");
  }
  discovery::GuardPtr after(std::chrono::milliseconds, std::function<void()>) override {
    throw std::logic_error("after");
  }
};

class OrderFeedTest : public testing::Test {
 protected:
  explicit OrderFeedTest(std::shared_ptr<const security::TrustedKeys> masters = nullptr, std::string followed_file = "")
      : masters_(std::move(masters)), followed_file_(std::move(followed_file)) {
    registry_.nodes[list_] = Node{.data = "", .version = 0, .created = ++created_};
  }
  ~OrderFeedTest() override {
    on_loop([this] { feed_.stop(); });
  }
  /// Does something on the feed's loop; what was posted before is done then.
  void on_loop(const std::function<void()>& action) {
    std::promise<void> done;
    loop_.post([&] {
      action();
      done.set_value();
    });
    done.get_future().wait();
  }
  std::vector<std::string> heard() {
    std::vector<std::string> all;
    on_loop([&] { all.swap(heard_); });
    return all;
  }
  /// Waits until the feed has said something by itself: an order must be gone for a moment.
  std::vector<std::string> heard_soon() {
    std::vector<std::string> all;
    EXPECT_TRUE(tests::eventually([&] {
      clock_.advance(pause);
      all = heard();
      return !all.empty();
    }));
    return all;
  }
  /// What the feed says when it looks after that time and that change. On the loop, because the feed's timer reads too.
  std::vector<std::string> heard_after(
      std::chrono::milliseconds time, const std::function<void()>& change = [] {}) {
    on_loop([&] {
      clock_.advance(time);
      change();
      feed_.read_orders();
    });
    return heard();
  }
  void give(const std::string& instance, std::int64_t epoch = 0) {
    discovery::OrderRecord order;
    order.epoch = epoch;
    order.instance = discovery::InstanceId(instance);
    order.plugin = "probe.so";
    registry_.nodes[path(instance)] = Node{.data = encode(order), .version = 0, .created = ++created_};
  }
  std::string path(const std::string& instance) const {
    return paths_.order("gw"_gateway, discovery::InstanceId(instance));
  }

  static constexpr auto pause = 200ms;  ///< how long an order must be gone
  const std::shared_ptr<const security::TrustedKeys> masters_;
  const std::string followed_file_;
  tests::HandClock clock_;
  const discovery::Paths paths_;
  const std::string list_ = paths_.orders("gw"_gateway);
  const std::string mark_ = discovery::freeze_path(paths_, "gw"_gateway);
  ToldRegistry registry_;
  std::int64_t created_ = 0;
  std::vector<std::string> heard_;             ///< of the loop
  std::vector<security::AuditEntry> audited_;  ///< of the loop
  std::size_t audited_before_ = 0;             ///< of the loop: lines before the last order was followed
  bool audit_is_full_ = false;                 ///< of the loop
  OrderFeed::Instances present_;               ///< the gateway's instances
  OrderFeed::Instances recorded_;              ///< those whose record the registry has
  EventLoop loop_{"order-feed"};
  OrderFeed feed_{registry_,
                  paths_,
                  "gw"_gateway,
                  loop_,
                  clock_,
                  {[this](const auto& names) { heard_.push_back("first " + std::to_string(names.size())); },
                   [this](const auto& order, std::int64_t) {
                     audited_before_ = audited_.size();
                     heard_.push_back("order " + order.instance);
                   },
                   [this](const auto& instance) { heard_.push_back("gone " + instance); }, [this] { return present_; },
                   [this](const auto& of) {
                     OrderFeed::Instances without;
                     for (const auto& instance : of) {
                       if (!recorded_.contains(instance)) without.insert(instance);
                     }
                     return without;
                   },
                   [this] { heard_.push_back("frozen"); }, [] {},
                   [this](const auto& orders) {
                     if (audit_is_full_) throw config::Error("the audit log cannot be written");
                     audited_.insert(audited_.end(), orders.begin(), orders.end());
                   },
                   [this](const auto& entry) { audited_.push_back(entry); }},
                  masters_,
                  followed_file_};
};

TEST_F(OrderFeedTest, AnOrderThatGoesBeforeTheListOfNamesWasToldWithItIsTakenBack) {
  feed_.start();
  registry_.tell_names(Names{});
  EXPECT_THAT(heard(), ElementsAre("first 0"));
  // The registry is there again. The feed reads by itself, and is faster than the watch of the list.
  give("a");
  registry_.tell_session(SessionState::connected);
  EXPECT_THAT(heard(), ElementsAre("order a"));
  // The list had been empty when it was read last, and is so again: its watch has nothing new to tell.
  registry_.nodes.erase(path("a"));
  registry_.tell_node.at(path("a"))(std::nullopt);
  EXPECT_THAT(heard_soon(), ElementsAre("gone a"));
}

TEST_F(OrderFeedTest, AnOrderThatGoesWithItsNameIsTakenBackBeforeItsNodeSaysSo) {
  give("a");
  feed_.start();
  registry_.tell_names(Names{"a"});
  on_loop([] {});  // it watches the node now
  registry_.tell_node.at(path("a"))(registry_.get(path("a")));
  EXPECT_THAT(heard(), ElementsAre("first 1", "order a"));
  registry_.nodes.erase(path("a"));
  registry_.tell_names(Names{});
  registry_.tell_node.at(path("a"))(std::nullopt);
  EXPECT_THAT(heard_soon(), ElementsAre("gone a"));
}

/// The key of a master in a folder of its own, and those who trust it.
struct MasterKey {
  const tests::TemporaryFolder folder;
  const security::test::Signer signer{folder / "", "master"};
  std::shared_ptr<const security::TrustedKeys> trust() const {
    security::TrustedKeys::Options options;
    options.require_signature = true;
    options.trusted_keys = {signer.public_file()};
    return std::make_shared<security::TrustedKeys>(options);
  }
};

class KeyedOrderFeed : private MasterKey, public OrderFeedTest {
 protected:
  KeyedOrderFeed() : OrderFeedTest(trust(), folder / "followed-orders.jsonl") {}
  void give_signed(const std::string& instance) {
    give(instance);
    auto& node = registry_.nodes.at(path(instance));
    node.data = security::sign_object(signer.key(), path(instance), node.data);
  }
  const std::string removal_ = paths_.removal("gw"_gateway, "a"_instance);
  Node removed() {
    const std::string bytes = encode(discovery::OrderRemoval{"a"_instance, 1, clock_.wall_ms()});
    return Node{.data = security::sign_object(signer.key(), removal_, bytes), .version = 0, .created = ++created_};
  }
};

TEST_F(KeyedOrderFeed, KeepsWhatRanWhenItsOrderWasRemovedBeforeTheStartUntilAMasterSaysSo) {
  present_ = recorded_ = {"a"_instance};
  feed_.start();
  registry_.tell_names(Names{});
  EXPECT_THAT(heard(), ElementsAre("first 1"));
  EXPECT_THAT(feed_.refused(), testing::HasSubstr("the removal of the order for a"));
  on_loop([&] {
    ASSERT_EQ(audited_.size(), 1u);
    EXPECT_EQ(audited_.front().order, removal_);
  });
  EXPECT_THAT(heard_after(10s), ElementsAre());
  on_loop([&] {
    registry_.nodes[paths_.removals("gw"_gateway)] = Node{};
    registry_.nodes[removal_] = removed();
  });
  registry_.tell_node.at(removal_)(registry_.nodes.at(removal_));
  EXPECT_THAT(heard_soon(), ElementsAre("gone a"));
  EXPECT_EQ(feed_.refused(), "");
  EXPECT_FALSE(registry_.nodes.contains(removal_));
}

TEST_F(KeyedOrderFeed, TakesARemovalFromBeforeTheStart) {
  present_ = recorded_ = {"a"_instance};
  registry_.nodes[removal_] = removed();
  feed_.start();
  registry_.tell_names(Names{});
  EXPECT_THAT(heard(), ElementsAre("first 0"));
  EXPECT_EQ(feed_.refused(), "");
}

TEST_F(KeyedOrderFeed, FollowsOrdersOnceTheAuditLogSaysSo) {
  for (const char* instance : {"a", "b"}) give_signed(instance);
  on_loop([&] { audit_is_full_ = true; });
  feed_.start();
  registry_.tell_names(Names{"a", "b"});
  EXPECT_THAT(heard(), ElementsAre("first 2"));
  EXPECT_THAT(feed_.refused(), testing::HasSubstr("cannot be written down"));
  on_loop([&] {
    EXPECT_GE(audited_.size(), 2u) << "they are refused";
    audited_.clear();
    audit_is_full_ = false;
  });
  EXPECT_THAT(heard_soon(), ElementsAre("order a", "order b"));
  on_loop([&] {
    EXPECT_EQ(audited_before_, 2u);
    ASSERT_EQ(audited_.size(), 4u) << "before, and after";
    EXPECT_EQ(audited_.back().outcome, "followed");
  });
  EXPECT_EQ(feed_.refused(), "");
}

TEST_F(KeyedOrderFeed, WritesDownOnceThatItFollowsARemovalAndThatItHasOnceThatIsOnTheDisk) {
  std::filesystem::create_directory(followed_file_);  // so that it cannot be written
  present_ = recorded_ = {"a"_instance};
  registry_.nodes[removal_] = removed();
  feed_.start();
  registry_.tell_names(Names{});
  on_loop([&] {
    feed_.read_orders();
    ASSERT_EQ(audited_.size(), 1u);
    EXPECT_EQ(audited_.front().who, "master");
    EXPECT_EQ(audited_.front().outcome, "");
    EXPECT_TRUE(heard_.empty());
    std::filesystem::remove(followed_file_);
    feed_.read_orders();
    ASSERT_EQ(audited_.size(), 2u);
    EXPECT_EQ(audited_.back().who, "master");
    EXPECT_EQ(audited_.back().outcome, "followed");
  });
  EXPECT_THAT(heard(), ElementsAre("first 0"));
}

/// A feed that follows the order of an instance "a", which runs and has its record.
class FrozenOrderFeed : public OrderFeedTest {
 protected:
  FrozenOrderFeed() {
    give("a", 1000);
    feed_.start();
    registry_.tell_names(Names{"a"});
    EXPECT_THAT(heard(), ElementsAre("first 1", "order a"));
    present_ = recorded_ = {"a"_instance};  // the loop is idle, and reads them from now on
  }
  void connect_again() {
    registry_.tell_session(SessionState::connected);
    on_loop([] {});
  }
  discovery::FreezeRecord mark() { return discovery::decode_freeze(registry_.nodes.at(mark_).data, mark_); }
  void adopt(std::int64_t epoch = 1) {
    registry_.nodes[list_].data = encode(discovery::Adoption{mark().token, epoch});
    registry_.tell_node.at(list_)(registry_.nodes.at(list_));
  }
};

TEST_F(FrozenOrderFeed, AnOrderThatGoesWhileItsRecordStaysIsTakenBack) {
  registry_.nodes.erase(path("a"));
  connect_again();
  EXPECT_THAT(heard_soon(), ElementsAre("gone a"));
  EXPECT_EQ(feed_.frozen(), "");
}

TEST_F(FrozenOrderFeed, OrdersWhoseNodeIsGoneAreNoOrderToUndeploy) {
  registry_.nodes.clear();
  registry_.tell_node.at(path("a"))(std::nullopt);
  registry_.tell_names(std::nullopt);
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  EXPECT_THAT(feed_.frozen(), testing::HasSubstr("emptied"));
  EXPECT_EQ(mark().reason, feed_.frozen());
}

TEST_F(FrozenOrderFeed, OrdersThatAreRemovedOneByOneBeforeTheirNodeAreNoOrderToUndeploy) {
  on_loop([&] {                        // in one go, so that the feed's timer cannot come in between
    registry_.nodes.erase(path("a"));  // the gateway's record of it stays
    feed_.read_orders();
    registry_.nodes.clear();
  });
  EXPECT_THAT(heard_soon(), ElementsAre("frozen"));
}

/// A feed that follows the orders of instances "a", "b" and "c", which run and have their records.
class FeedWhoseOrdersGo : public FrozenOrderFeed {
 protected:
  FeedWhoseOrdersGo() {
    for (const char* more : {"b", "c"}) give(more, 1000);
    registry_.tell_names(Names{"a", "b", "c"});
    present_ = recorded_ = {"a"_instance, "b"_instance, "c"_instance};
    EXPECT_THAT(heard_after(0ms), ElementsAre("order b", "order c"));
  }
  std::vector<std::string> heard_when_gone(const std::string& instance, std::chrono::milliseconds after) {
    return heard_after(after, [&] { registry_.nodes.erase(path(instance)); });
  }
};

TEST_F(FeedWhoseOrdersGo, TakesNoneBackWhileOthersGo) {
  EXPECT_THAT(heard_when_gone("a", 0ms), ElementsAre());
  EXPECT_THAT(heard_when_gone("b", pause - 1ms), ElementsAre());
  EXPECT_THAT(heard_when_gone("c", pause - 1ms), ElementsAre());
  EXPECT_THAT(heard_after(pause - 1ms), ElementsAre());
  EXPECT_THAT(heard_after(1ms), ElementsAre("gone a", "gone b", "gone c"));
}

TEST_F(FeedWhoseOrdersGo, TakesNoneBackWhenItFindsAnotherOneGoneAtTheEndOfThePause) {
  EXPECT_THAT(heard_when_gone("a", 0ms), ElementsAre());
  EXPECT_THAT(heard_when_gone("b", pause), ElementsAre());
  EXPECT_THAT(heard_after(pause), ElementsAre("gone a", "gone b"));
}

TEST_F(FeedWhoseOrdersGo, IsFrozenWhenTheirNodeGoesInTheEnd) {
  EXPECT_THAT(heard_when_gone("a", 0ms), ElementsAre());
  EXPECT_THAT(heard_when_gone("b", pause - 1ms), ElementsAre());
  EXPECT_THAT(heard_when_gone("c", pause - 1ms), ElementsAre());
  EXPECT_THAT(heard_after(pause - 1ms, [&] { registry_.nodes.clear(); }), ElementsAre("frozen"));
  EXPECT_THAT(heard_after(pause), ElementsAre());
}

TEST_F(FeedWhoseOrdersGo, IsFrozenWhenTheirNodeGoesWhileItIsRead) {
  EXPECT_THAT(heard_when_gone("a", 0ms), ElementsAre());
  const auto going = [&] { registry_.before_names = [this] { registry_.nodes.clear(); }; };
  EXPECT_THAT(heard_after(pause, going), ElementsAre("frozen"));
}

TEST_F(FeedWhoseOrdersGo, TakesThemBackInTheEndEvenIfOthersGoAllTheTime) {
  Names more;
  for (int i = 10; i < 60; ++i) more.push_back(std::to_string(i));
  for (const auto& instance : more) give(instance, 1000);
  EXPECT_THAT(heard_after(0ms), testing::SizeIs(50));
  EXPECT_THAT(heard_when_gone("a", 0ms), ElementsAre());
  Names heard;
  std::size_t went = 0;
  for (; went < more.size() && heard.empty(); ++went) heard = heard_when_gone(more[went], pause - 1ms);
  EXPECT_THAT(heard, ElementsAre("gone a"));
  EXPECT_EQ(went, 26U) << "after five seconds";
}

TEST_F(FeedWhoseOrdersGo, StartsThePauseAnewForAnOrderThatGoesAgain) {
  EXPECT_THAT(heard_when_gone("a", 0ms), ElementsAre());
  EXPECT_THAT(heard_after(pause, [&] { give("a", 1000); }), ElementsAre("order a"));
  EXPECT_THAT(heard_when_gone("a", pause), ElementsAre());
  EXPECT_THAT(heard_after(pause), ElementsAre("gone a"));
}

TEST_F(FrozenOrderFeed, OrdersInAnotherNodeAreNotFollowed) {
  registry_.nodes.clear();
  registry_.nodes[list_] = Node{.data = "", .version = 0, .created = 100};
  give("b");
  connect_again();
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  registry_.tell_names(Names{"b"});
  EXPECT_THAT(heard(), ElementsAre());
}

TEST_F(FrozenOrderFeed, AnOrderThatGoesWithItsRecordIsNotTakenBack) {
  registry_.nodes.erase(path("a"));
  recorded_.clear();
  connect_again();
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  EXPECT_TRUE(mark().lasting);
  recorded_ = present_;  // the gateway has written it again
  connect_again();
  EXPECT_THAT(heard(), ElementsAre()) << "which proves nothing any more";
  EXPECT_THAT(feed_.frozen(), testing::HasSubstr("earlier state"));
}

TEST_F(FrozenOrderFeed, AnOrderInAnEarlierVersionIsNotFollowed) {
  registry_.nodes[path("a")].version = 5;
  registry_.tell_node.at(path("a"))(registry_.nodes.at(path("a")));
  EXPECT_THAT(heard(), ElementsAre("order a"));
  registry_.nodes[path("a")].version = 4;
  connect_again();
  EXPECT_THAT(heard(), ElementsAre("frozen"));
}

TEST_F(FrozenOrderFeed, AnAdoptionMakesAnEmptyListTheOrder) {
  registry_.nodes.erase(path("a"));
  recorded_.clear();
  connect_again();
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  registry_.nodes[list_].data = encode(discovery::Adoption{"of another freeze", 7});
  registry_.tell_node.at(list_)(registry_.nodes.at(list_));
  EXPECT_THAT(heard(), ElementsAre());
  adopt();
  EXPECT_THAT(heard_soon(), ElementsAre("gone a"));
  EXPECT_EQ(feed_.frozen(), "");
  EXPECT_FALSE(registry_.nodes.contains(mark_));
}

/// A feed whose registry gets an earlier state, in which no order of it differs: only masters lead anew.
class FeedOfOlderLeaders : public FrozenOrderFeed {
 protected:
  FeedOfOlderLeaders() { registry_.nodes[paths_.masters()] = Node{}; }
  void stands_for_election(std::int64_t epoch) {
    registry_.nodes[paths_.masters() + "/member"] = Node{.data = "", .version = 0, .created = epoch};
  }
  void give_later(const std::string& instance, std::int64_t epoch) {
    give(instance, epoch);
    registry_.tell_names(Names{"a", instance});
    on_loop([] {});
    registry_.tell_node.at(path(instance))(registry_.nodes.at(path(instance)));
    on_loop([] {});
  }
};

TEST_F(FeedOfOlderLeaders, IgnoresAnOrderOfAMasterThatLeadsNoMore) {
  stands_for_election(1001);
  give_later("b", 999);
  EXPECT_THAT(heard(), ElementsAre());
  EXPECT_EQ(feed_.frozen(), "");
}

TEST_F(FeedOfOlderLeaders, IsFrozenByAnOrderOfAMasterThatLeads) {
  stands_for_election(999);
  give_later("b", 999);
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  EXPECT_THAT(feed_.frozen(), testing::HasSubstr("put back to an earlier state: the order of b"));
  adopt(999);
  EXPECT_THAT(heard_soon(), ElementsAre("order a", "order b"));
  EXPECT_EQ(feed_.frozen(), "");
}

TEST_F(FeedOfOlderLeaders, AsksAgainWhoLeadsWhenTheRegistryDidNotAnswer) {
  stands_for_election(999);
  on_loop([this] { registry_.unanswered = paths_.masters(); });
  give_later("b", 999);
  EXPECT_THAT(heard(), ElementsAre());
  EXPECT_EQ(feed_.frozen(), "");
  EXPECT_EQ(heard_after(0ms), Names()) << "it is not known yet either when all orders are read";
  on_loop([this] { registry_.unanswered.clear(); });
  EXPECT_THAT(heard_soon(), ElementsAre("frozen"));
  EXPECT_THAT(feed_.frozen(), testing::HasSubstr("put back to an earlier state: the order of b"));
}

TEST_F(FeedOfOlderLeaders, AsksOnceWhoLeadsForManyOrders) {
  stands_for_election(999);
  for (const char* more : {"b", "c", "d"}) give(more, 999);
  registry_.tell_names(Names{"a", "b", "c", "d"});
  on_loop([this] {  // in one go, so that all are told before the orders are read again
    for (const char* more : {"b", "c", "d"}) registry_.tell_node.at(path(more))(registry_.nodes.at(path(more)));
  });
  EXPECT_THAT(heard_soon(), ElementsAre("frozen"));
  EXPECT_EQ(registry_.read[paths_.masters()], 1);
}

TEST_F(FeedOfOlderLeaders, FollowsAMasterThatLeadsWhenThereIsNothingToLose) {
  present_ = recorded_ = {};
  stands_for_election(999);
  give_later("b", 999);
  EXPECT_THAT(heard_soon(), ElementsAre("order a", "order b"));
  EXPECT_EQ(feed_.frozen(), "");
}

TEST_F(FrozenOrderFeed, AnAdoptedRegistryCountsEpochsAnew) {
  registry_.nodes.clear();
  connect_again();
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  registry_.nodes[list_] = Node{.data = "", .version = 0, .created = 1};
  give("a", 2);
  give("b", 3);
  adopt();
  EXPECT_THAT(heard(), ElementsAre("order a", "order b"));
  give("c", 4);
  registry_.tell_names(Names{"a", "b", "c"});
  on_loop([] {});
  registry_.tell_node.at(path("c"))(registry_.nodes.at(path("c")));
  EXPECT_THAT(heard(), ElementsAre("order c"));
}

TEST_F(FrozenOrderFeed, OrdersOfMastersThatLedBeforeTheAdoptionAreNotFollowedAfterIt) {
  registry_.nodes.clear();
  connect_again();
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  registry_.nodes[list_] = Node{.data = "", .version = 0, .created = 1};
  give("a", 2);
  adopt(7);
  EXPECT_THAT(heard(), ElementsAre("order a")) << "which the master adopted";
  EXPECT_EQ(feed_.epoch(), 7);
  give("b", 6);
  give("c", 7);
  registry_.tell_names(Names{"a", "b", "c"});
  on_loop([] {});
  for (const char* instance : {"b", "c"}) registry_.tell_node.at(path(instance))(registry_.nodes.at(path(instance)));
  EXPECT_THAT(heard(), ElementsAre("order c"));
}

TEST_F(FrozenOrderFeed, TheOrdersOwnNodeThatComesBackIsFollowed) {
  const auto before = registry_.nodes;
  registry_.nodes.clear();
  connect_again();
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  registry_.nodes = before;  // the address led to another registry for a while
  connect_again();
  EXPECT_EQ(feed_.frozen(), "");
  give("b");
  connect_again();
  EXPECT_THAT(heard(), testing::Contains("order b"));
}

TEST_F(FrozenOrderFeed, AGatewayWithoutInstancesHasNothingToLose) {
  registry_.nodes.erase(path("a"));
  connect_again();
  EXPECT_THAT(heard_soon(), ElementsAre("gone a"));
  present_.clear();
  registry_.nodes.clear();
  connect_again();
  give("b", 3);
  registry_.tell_names(Names{"b"});
  EXPECT_THAT(heard(), ElementsAre("order b"));
  EXPECT_EQ(feed_.frozen(), "");
  give("c", 4);  // the masters of an emptied registry count epochs anew
  registry_.tell_names(Names{"b", "c"});
  on_loop([] {});
  registry_.tell_node.at(path("c"))(registry_.nodes.at(path("c")));
  EXPECT_THAT(heard(), ElementsAre("order c"));
}

TEST_F(OrderFeedTest, AGatewayWithAdoptedInstancesAndNoOrdersIsFrozenFromTheStart) {
  present_ = recorded_ = {"a"_instance};
  registry_.nodes.clear();
  feed_.start();
  registry_.tell_session(SessionState::connected);
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  registry_.nodes[list_] = Node{.data = "", .version = 0, .created = 100};  // somebody gives an order
  give("b");
  registry_.tell_names(Names{"b"});
  EXPECT_THAT(heard(), ElementsAre());
}

TEST_F(OrderFeedTest, AFreezeOutlivesTheGateway) {
  registry_.nodes[mark_] = Node{.data = encode(discovery::FreezeRecord{"why", 5, "token", false})};
  give("a");
  feed_.start();
  registry_.tell_names(Names{"a"});
  EXPECT_THAT(heard(), ElementsAre("frozen"));
  EXPECT_EQ(feed_.frozen(), "why");
  registry_.nodes[list_].data = encode(discovery::Adoption{"token", 7});
  registry_.tell_node.at(list_)(registry_.nodes.at(list_));
  EXPECT_THAT(heard(), ElementsAre("first 1", "order a"));
}

}  // namespace
}  // namespace iotcloud::gateway
