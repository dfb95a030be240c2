// The order in which a gateway hears of its orders, told step by step by a registry that the test controls.
#include <functional>
#include <future>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/gateway/registration/order_feed.h>

namespace iotcloud::gateway {
namespace {

using discovery::Node;
using discovery::SessionState;
using testing::ElementsAre;
using Names = std::vector<std::string>;

/// Reads tell what stands in `nodes`. Watches tell what the test says, and when.
class ToldRegistry final : public discovery::Registry {
 public:
  std::map<std::string, Node> nodes;  ///< by path
  std::function<void(const std::optional<Names>&)> tell_names;
  std::map<std::string, std::function<void(const std::optional<Node>&)>> tell_node;  ///< by path
  std::function<void(SessionState)> tell_session;

  std::optional<Node> get(const std::string& path) override {
    const auto found = nodes.find(path);
    return found == nodes.end() ? std::nullopt : std::optional(found->second);
  }
  std::optional<Names> children(const std::string& path) override {
    Names names;
    for (const auto& [child, node] : nodes) {
      if (child.starts_with(path + "/")) names.push_back(child.substr(path.size() + 1));
    }
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

  // A feed only reads.
  void create(const std::string&, const std::string&, bool, const discovery::Fence&) override { FAIL(); }
  void set(const std::string&, const std::string&, std::int64_t, const discovery::Fence&) override { FAIL(); }
  bool remove(const std::string&, std::int64_t, const discovery::Fence&) override { throw std::logic_error("remove"); }
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
  void give(const std::string& instance) {
    discovery::OrderRecord order;
    order.instance = instance;
    order.plugin = "probe.so";
    registry_.nodes[path(instance)] = Node{.data = encode(order), .version = 0, .created = ++created_};
  }
  std::string path(const std::string& instance) const { return paths_.order("gw", instance); }

  const discovery::Paths paths_;
  ToldRegistry registry_;
  std::int64_t created_ = 0;
  std::vector<std::string> heard_;  ///< of the loop
  EventLoop loop_{"order-feed"};
  OrderFeed feed_{registry_,
                  paths_,
                  "gw",
                  loop_,
                  {[this](const auto& names) { heard_.push_back("first " + std::to_string(names.size())); },
                   [this](const auto& order, std::int64_t) { heard_.push_back("order " + order.instance); },
                   [this](const auto& instance) { heard_.push_back("gone " + instance); }}};
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
  registry_.nodes.clear();
  registry_.tell_node.at(path("a"))(std::nullopt);
  EXPECT_THAT(heard(), ElementsAre("gone a"));
}

TEST_F(OrderFeedTest, AnOrderThatGoesWithItsNameIsTakenBackBeforeItsNodeSaysSo) {
  give("a");
  feed_.start();
  registry_.tell_names(Names{"a"});
  on_loop([] {});  // it watches the node now
  registry_.tell_node.at(path("a"))(registry_.get(path("a")));
  EXPECT_THAT(heard(), ElementsAre("first 1", "order a"));
  registry_.tell_names(Names{});
  registry_.tell_node.at(path("a"))(std::nullopt);
  EXPECT_THAT(heard(), ElementsAre("gone a"));
}

}  // namespace
}  // namespace iotcloud::gateway
