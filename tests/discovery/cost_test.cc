// What is asked of the registry's server: counted, because thousands of drivers multiply it.
#include <iotcloud/discovery/client/registry_client.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/tests/discovery/contract_fixture.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery::tests {
namespace {

using testing::AnyOf;
using testing::Contains;
using testing::ElementsAre;
using testing::UnorderedElementsAre;

/// Passes everything on and notes what was asked, "get /path" and the like.
class CountingConnection : public RegistryConnection {
 public:
  CountingConnection(std::unique_ptr<RegistryConnection> below, Seen<std::string>& asked)
      : below_(std::move(below)), asked_(asked) {}
  bool open(Events events) override { return below_->open(std::move(events)); }
  bool renew() override { return below_->renew(); }
  bool ask_for_new(std::function<void()> serves) override { return below_->ask_for_new(std::move(serves)); }
  void ask_no_more() override { below_->ask_no_more(); }
  std::chrono::milliseconds certain_after_disconnect(std::chrono::milliseconds timeout) const override {
    return below_->certain_after_disconnect(timeout);
  }
  std::chrono::milliseconds longest_attempt(std::chrono::milliseconds timeout) const override {
    return below_->longest_attempt(timeout);
  }
  void create(const std::string& path, const std::string& data, bool ephemeral, bool sequential, const Fence& fence,
              Done done) override {
    asked_.add("create " + path);
    below_->create(path, data, ephemeral, sequential, fence, std::move(done));
  }
  void set(const std::string& path, const std::string& data, std::int64_t expected_version, const Fence& fence,
           Done done) override {
    asked_.add("set " + path);
    below_->set(path, data, expected_version, fence, std::move(done));
  }
  void remove(const std::string& path, std::int64_t expected_version, const Fence& fence, Done done) override {
    asked_.add("remove " + path);
    below_->remove(path, expected_version, fence, std::move(done));
  }
  void get(const std::string& path, bool watch, Done done) override {
    asked_.add("get " + path);
    below_->get(path, watch, std::move(done));
  }
  void children(const std::string& path, bool watch, Done done) override {
    asked_.add("children " + path);
    below_->children(path, watch, std::move(done));
  }

 private:
  const std::unique_ptr<RegistryConnection> below_;
  Seen<std::string>& asked_;
};

class Cost : public testing::Test {
 protected:
  void put_driver(int instance, const std::string& battery) {
    DriverRecord record;
    record.name = "turtle"_driver;
    record.instance = InstanceId(std::to_string(instance));
    record.state = DriverState::active;
    record.metadata["battery"] = battery;
    ChannelRecord channel;
    channel.driver = record.name;
    channel.instance = record.instance;
    channel.name = "kinect";
    put(*writer_, paths_.channel("turtle"_driver, record.instance, channel.name), encode(channel));
    put(*writer_, paths_.instance("turtle"_driver, record.instance), encode(record));
  }
  std::unique_ptr<DriverDirectory> directory(const std::string& where) {
    DriverDirectory::Callbacks callbacks;
    callbacks.on_channel = [this](const ChannelRecord& record) { told_.add("+" + record.instance); };
    callbacks.on_channel_gone = [this](const ChannelRecord& record) { told_.add("-" + record.instance); };
    callbacks.on_choice = [this](const InstanceId& instance, std::optional<bool>) { judged_.add(instance); };
    return std::make_unique<DriverDirectory>(*registry_, paths_, "turtle"_driver, "kinect", std::move(callbacks),
                                             Selection::parse(where));
  }
  /// What was asked after the first `count` questions.
  std::vector<std::string> asked_since(std::size_t count) const {
    const auto all = asked_.all();
    return {all.begin() + static_cast<std::ptrdiff_t>(count), all.end()};
  }

  const Paths paths_;
  const std::shared_ptr<embedded::RegistryServer> server_ = embedded::RegistryServer::named("cost");
  Seen<std::string> asked_;
  Seen<std::string> told_;
  Seen<std::string> judged_;
  const std::unique_ptr<Registry> registry_ =
      make_client(std::make_unique<CountingConnection>(embedded::make_connection(server_, patience), asked_), {});
  const std::unique_ptr<Registry> writer_ = make_registry({.url = "embedded://cost"});
};

TEST_F(Cost, ADriverThatChangesIsReadAndJudgedAloneAmongMany) {
  constexpr int many = 100;
  for (int i = 0; i < many; ++i) put_driver(i, "50");
  const auto chosen = directory("battery > 20");
  ASSERT_TRUE(told_.wait_for_count(many));
  const std::size_t asked = asked_.all().size();
  const std::size_t judged = judged_.all().size();
  EXPECT_EQ(judged, static_cast<std::size_t>(many));

  put_driver(42, "10");
  ASSERT_TRUE(told_.wait_for_last("-42"));
  const auto all = judged_.all();
  EXPECT_THAT(std::vector<std::string>(all.begin() + many, all.end()), ElementsAre("42"));
  // A node that was read just before (2 ms) is read again a little later, and so the channel perhaps after this.
  const std::string instance = "get " + paths_.instance("turtle"_driver, "42"_instance);
  EXPECT_THAT(asked_since(asked),
              AnyOf(ElementsAre(instance),
                    UnorderedElementsAre(instance, "get " + paths_.channel("turtle"_driver, "42"_instance, "kinect"))));
}

TEST_F(Cost, ADriverThatComesCostsItsOwnRecordsAndOneListForAllWhoWatch) {
  for (int i = 10; i < 60; ++i) put_driver(i, "50");
  const auto one = directory("battery > 20");
  const auto other = directory("battery > 30");
  ASSERT_TRUE(told_.wait_for_count(100));
  const std::size_t asked = asked_.all().size();

  put_driver(70, "50");
  ASSERT_TRUE(told_.wait_for_count(102));
  const std::string list = "children " + paths_.driver("turtle"_driver);
  const auto since = asked_since(asked);
  EXPECT_EQ(std::count(since.begin(), since.end(), list), 1);
  for (const std::string& question : since) {
    EXPECT_TRUE(question == list || question.starts_with("get " + paths_.instance("turtle"_driver, "70"_instance)))
        << question;
  }
}

TEST_F(Cost, SeveralWatchesOfOneNodeReadItOnceForEachChange) {
  writer_->create("/node", "first");
  std::vector<GuardPtr> guards;
  for (int i = 0; i < 5; ++i) {
    guards.push_back(
        registry_->watch_node("/node", [this](const std::optional<Node>& node) { told_.add(node->data); }));
  }
  ASSERT_TRUE(told_.wait_for_count(5));
  const std::size_t asked = asked_.all().size();
  writer_->set("/node", "second");
  ASSERT_TRUE(told_.wait_for_count(10));
  EXPECT_THAT(asked_since(asked), ElementsAre("get /node"));
  EXPECT_THAT(told_.all(), Contains("second").Times(5));

  // One that comes late is told, and tells nobody else again.
  guards.push_back(registry_->watch_node("/node", [this](const std::optional<Node>& node) { told_.add(node->data); }));
  ASSERT_TRUE(told_.wait_for_count(11));
  registry_->get("/");
  EXPECT_EQ(told_.all().size(), 11U);
}

TEST_F(Cost, ElectionsOfWhoeverIsFirstShareTheWayToTheirParent) {
  std::vector<std::unique_ptr<Election>> elections;
  for (int i = 0; i < 50; ++i) {
    Election::Callbacks callbacks;
    callbacks.on_elected = [this](std::int64_t) { told_.add("elected"); };
    elections.push_back(std::make_unique<Election>(*registry_, "/deep/in/the/tree/" + std::to_string(i), "it",
                                                   std::move(callbacks), Succession::whoever_is_first));
  }
  ASSERT_TRUE(told_.wait_for_count(50));
  // The first one's creation fails and makes the four nodes above (some twice, because it goes up and down again).
  EXPECT_LE(asked_.all().size(), 2 * 50U + 10);
}

}  // namespace
}  // namespace iotcloud::discovery::tests
