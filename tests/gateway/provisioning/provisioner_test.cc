// What the provisioner decides, without a gateway.
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/instance_name.h>
#include <iotcloud/gateway/provisioning/provisioner.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::gateway {
namespace {

using discovery::InstanceId;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;
using namespace std::chrono_literals;

constexpr const char* meters = R"(
finders: {house: {plugin: finder.so}}
rules:
  meters:
    finder: house
    where: 'kind == "meter"'
    plugin: meter.so
    name: "meter-{id}"
    properties: {url: "tcp://{address:host}:502", unit: "{unit:text}"}
    metadata: {model: "{model:text}"}
    grace: 10s
    most: 3
    rate: 1000
)";

class ProvisionerTest : public ::testing::Test {
 protected:
  ProvisionerTest() { restart(); }

  void restart(const std::string& rules = meters, const std::set<InstanceId>& adopted = {}) {
    make(rules, adopted);
    provisioner_->begin(adopted);
    provisioner_->work();
  }
  /// One that does not know the registry's orders yet.
  void make(const std::string& rules, const std::set<InstanceId>& adopted = {}) {
    provisioner_.reset();
    running_.clear();
    Provisioner::Options options;
    options.gateway = "gw"_gateway;
    options.rules = ProvisioningRules::parse(rules, "rules.yaml");
    options.file = folder_ / "provisioned.jsonl";
    options.clock = &clock_;
    options.metrics = &metrics_;
    options.run = [this](const auto& order, bool again) {
      running_[order.instance] = order;
      if (order.name != "house") events_.push_back((again ? "again " : "run ") + order.name);
    };
    options.end = [this](const auto& instance) {
      const auto found = running_.find(instance);
      if (found == running_.end()) return;
      events_.push_back("end " + found->second.name);
      running_.erase(found);
    };
    for (const auto& instance : adopted) running_[instance].name = "adopted";
    provisioner_ = std::make_unique<Provisioner>(std::move(options));
    provisioner_->set_draining(false);
  }

  static InstanceId id(const std::string& name) { return discovery::named_instance_id("gw"_gateway, name, 1); }
  static FoundThing meter(const std::string& id, const std::string& address = "10.0.0.1") {
    return {id, {{"kind", "meter"}, {"id", id}, {"address", address}}};
  }
  void tell(std::vector<FoundThing> found, std::vector<std::string> gone = {}, bool whole = false, bool sees = true) {
    provisioner_->heard({id("house"), whole, sees, std::move(found), std::move(gone)});
    provisioner_->work();
  }
  void pass(std::chrono::milliseconds time) {
    clock_.advance(time);
    provisioner_->work();
  }
  /// The names of what runs, besides the finder.
  std::vector<std::string> names() const {
    std::vector<std::string> names;
    for (const auto& [instance, order] : running_) {
      if (order.name != "house") names.push_back(order.name);
    }
    std::sort(names.begin(), names.end());
    return names;
  }
  std::map<std::string, std::string> finder_says() {
    pass(1s);
    return running_.at(id("house")).metadata;
  }
  void say(const std::string& name, bool active, bool withheld = false) {
    discovery::OrderRecord word;
    word.instance = id(name);
    word.made_by = "rule meters";
    word.active = active;
    word.withheld = withheld;
    provisioner_->said(word);
    provisioner_->work();
  }
  std::uint64_t refused(const std::string& reason) {
    return metrics_.counter("iotcloud_provisioning_refused_total", "", {{"rule", "meters"}, {"reason", reason}})
        .value();
  }

  tests::TemporaryFolder folder_;
  tests::HandClock clock_;
  config::Metrics metrics_;
  std::map<InstanceId, discovery::OrderRecord> running_;
  std::vector<std::string> events_;  ///< of what runs besides the finder
  std::unique_ptr<Provisioner> provisioner_;
};

TEST_F(ProvisionerTest, makes_an_instance_of_what_is_found_and_ends_it_a_while_after_it_is_gone) {
  EXPECT_EQ(running_.at(id("house")).made_by, "finder house");
  tell({meter("1"), {"2", {{"kind", "camera"}, {"id", "2"}}}});
  ASSERT_THAT(names(), ElementsAre("meter-1"));
  const auto& order = running_.at(id("meter-1"));
  EXPECT_EQ(order.plugin, "meter.so");
  EXPECT_EQ(order.made_by, "rule meters");
  EXPECT_EQ(order.properties.at("url"), "tcp://10.0.0.1:502");
  EXPECT_FALSE(order.properties.contains("unit")) << "what was not found is left out";
  EXPECT_THAT(order.metadata, IsEmpty());
  tell({}, {"1"});
  pass(9s);
  EXPECT_THAT(names(), ElementsAre("meter-1"));
  pass(1s);
  EXPECT_THAT(names(), IsEmpty());
}

TEST_F(ProvisionerTest, keeps_an_instance_whose_thing_comes_back_in_time) {
  tell({meter("1")});
  events_.clear();
  tell({}, {"1"});
  pass(9s);
  tell({meter("1")});
  pass(60s);
  EXPECT_THAT(names(), ElementsAre("meter-1"));
  EXPECT_THAT(events_, ::testing::Not(::testing::Contains("end meter-1")));
}

TEST_F(ProvisionerTest, ends_nothing_while_its_finder_does_not_see) {
  tell({meter("1"), meter("2")});
  tell({}, {}, false, false);
  pass(1h);
  EXPECT_THAT(names(), ElementsAre("meter-1", "meter-2"));
  tell({meter("2")}, {}, true, true);  // it sees again, and the first one is not there
  pass(9s);
  EXPECT_THAT(names(), ElementsAre("meter-1", "meter-2"));
  pass(1s);
  EXPECT_THAT(names(), ElementsAre("meter-2"));
}

TEST_F(ProvisionerTest, makes_an_instance_anew_when_what_was_found_changes_and_not_too_often) {
  tell({meter("1")});
  tell({meter("1", "10.0.0.2")});
  EXPECT_EQ(running_.at(id("meter-1")).properties.at("url"), "tcp://10.0.0.1:502") << "it was made just now";
  pass(10s);
  EXPECT_EQ(running_.at(id("meter-1")).properties.at("url"), "tcp://10.0.0.2:502");
}

TEST_F(ProvisionerTest, makes_no_more_than_the_rule_allows) {
  tell({meter("1"), meter("2"), meter("3"), meter("4"), meter("5")});
  EXPECT_THAT(names(), ElementsAre("meter-1", "meter-2", "meter-3"));
  EXPECT_EQ(refused("most"), 2U);
  EXPECT_EQ(finder_says().at("refused"), "2");
  EXPECT_THAT(finder_says().at("refused_first"), HasSubstr("3 instances"));
  tell({}, {"2"});
  pass(10s);
  EXPECT_THAT(names(), ElementsAre("meter-1", "meter-3", "meter-4")) << "there is room";
}

TEST_F(ProvisionerTest, makes_them_no_faster_than_the_rule_allows) {
  std::string slow = meters;
  slow.replace(slow.find("rate: 1000"), 10, "rate: 2   ");
  slow.replace(slow.find("most: 3"), 7, "most: 9");
  restart(slow);
  tell({meter("1"), meter("2"), meter("3"), meter("4"), meter("5")});
  EXPECT_EQ(names().size(), 2U);
  pass(500ms);
  EXPECT_EQ(names().size(), 3U);
  pass(1s);
  EXPECT_EQ(names().size(), 5U);
}

TEST_F(ProvisionerTest, takes_no_value_that_does_not_fit_and_no_name_twice) {
  auto bad = meter("1", "10.0.0.1:80/x,y=z");
  tell({bad});
  EXPECT_THAT(names(), IsEmpty());
  EXPECT_EQ(refused("value"), 1U);
  tell({{"2", {{"kind", "meter"}}}});
  EXPECT_THAT(finder_says().at("refused"), "2");
  auto thief = meter("3");
  tell({thief});
  thief.key = "4";
  thief.attributes["address"] = "10.6.6.6";
  tell({thief});
  EXPECT_EQ(refused("name"), 1U);
  EXPECT_EQ(running_.at(id("meter-3")).properties.at("url"), "tcp://10.0.0.1:502");
  tell({}, {"3"});
  pass(10s);
  EXPECT_EQ(running_.at(id("meter-3")).properties.at("url"), "tcp://10.6.6.6:502") << "the name is free";
}

TEST_F(ProvisionerTest, takes_no_name_of_a_finder) {
  std::string rules = meters;
  rules.replace(rules.find("meter-{id}"), 10, "{id}");
  restart(rules);
  tell({meter("house")});
  EXPECT_EQ(running_.at(id("house")).made_by, "finder house");
  EXPECT_EQ(refused("name"), 1U);
}

TEST_F(ProvisionerTest, believes_only_its_finders_and_no_more_things_than_one_may_find) {
  provisioner_->heard({id("stranger"), true, true, {meter("1")}, {}});
  provisioner_->work();
  EXPECT_THAT(names(), IsEmpty());
  std::vector<FoundThing> flood;
  for (int i = 0; i < 10'100; ++i) flood.push_back(meter(std::to_string(i)));
  flood.push_back({"", {{"kind", "meter"}}});
  flood.push_back({"big", {{"kind", std::string(20'000, 'x')}}});
  tell(flood);
  EXPECT_EQ(finder_says().at("found"), "10000");
  EXPECT_EQ(names().size(), 3U);
}

TEST_F(ProvisionerTest, leaves_alone_what_a_person_has_undeployed_until_it_is_started) {
  tell({meter("1"), meter("2")});
  say("meter-1", false, true);
  EXPECT_THAT(names(), ElementsAre("meter-2"));
  EXPECT_EQ(finder_says().at("undeployed"), "meter-1 " + id("meter-1").str()) << "so a person can start it";
  tell({meter("1", "10.0.0.9")});
  pass(60s);
  EXPECT_THAT(names(), ElementsAre("meter-2")) << "found again, changed";
  tell({}, {"1"});
  pass(60s);
  tell({meter("1")});
  pass(60s);
  EXPECT_THAT(names(), ElementsAre("meter-2")) << "gone and back";
  say("meter-1", true);
  EXPECT_THAT(names(), ElementsAre("meter-1", "meter-2"));
}

TEST_F(ProvisionerTest, stops_and_starts_what_a_person_says) {
  tell({meter("1")});
  say("meter-1", false);
  EXPECT_FALSE(running_.at(id("meter-1")).active);
  tell({meter("1", "10.0.0.9")});
  pass(60s);
  EXPECT_FALSE(running_.at(id("meter-1")).active);
  events_.clear();
  say("meter-1", true);
  EXPECT_THAT(events_, ElementsAre("again meter-1"));
  EXPECT_TRUE(running_.at(id("meter-1")).active);
  say("house", false, true);
  EXPECT_FALSE(running_.contains(id("house")));
}

TEST_F(ProvisionerTest, gives_way_to_a_masters_order_for_the_same_name) {
  tell({meter("1")});
  events_.clear();
  provisioner_->ordered(id("meter-1"));  // the gateway runs it as ordered from now on
  tell({meter("1", "10.0.0.9")});
  tell({}, {"1"});
  pass(60s);
  EXPECT_THAT(events_, ::testing::Not(::testing::Contains("end meter-1")));
  tell({meter("1")});
  EXPECT_THAT(events_, ::testing::Not(::testing::Contains("run meter-1")));
  provisioner_->unsaid(id("meter-1"));
  EXPECT_THAT(events_, ElementsAre("end meter-1")) << "whoever removed the order sees it gone";
  pass(2s);
  EXPECT_THAT(events_, ElementsAre("end meter-1", "run meter-1")) << "the order ends, and the rule counts again";
  provisioner_->unsaid(id("unknown"));
}

TEST_F(ProvisionerTest, knows_after_a_restart_what_it_had_made) {
  tell({meter("1"), meter("2")});
  restart(meters, {id("meter-1"), id("meter-9")});
  EXPECT_THAT(names(), UnorderedElementsAre("meter-1", "meter-2")) << "and ends what it does not know";
  pass(1h);
  EXPECT_THAT(names(), ElementsAre("meter-1", "meter-2")) << "the finder does not see yet";
  tell({meter("2")}, {}, true);
  pass(10s);
  EXPECT_THAT(names(), ElementsAre("meter-2"));
}

TEST_F(ProvisionerTest, passes_over_damaged_lines_of_its_file) {
  tell({meter("1"), meter("2")});
  provisioner_.reset();
  const auto file = folder_ / "provisioned.jsonl";
  tests::write_file(file, "{\"finder\": 7}\nnonsense\n" + tests::read_file(file) + "{\"finder\":\"ho");
  restart();
  EXPECT_THAT(names(), ElementsAre("meter-1", "meter-2"));
}

TEST_F(ProvisionerTest, makes_nothing_new_while_the_gateway_drains) {
  tell({meter("1")});
  provisioner_->set_draining(true);
  tell({meter("2")});
  EXPECT_THAT(names(), ElementsAre("meter-1"));
  provisioner_->set_draining(false);
  provisioner_->work();
  EXPECT_THAT(names(), ElementsAre("meter-1", "meter-2"));
}

TEST_F(ProvisionerTest, follows_other_rules) {
  tell({meter("1"), {"2", {{"kind", "camera"}, {"id", "2"}}}});
  std::string other = meters;
  other.replace(other.find("== \"meter\""), 10, "== \"camera\"");
  other.replace(other.find("meter-{id}"), 10, "camera-{id}");
  other.replace(other.find("{address:host}"), 14, "there");
  provisioner_->set_rules(ProvisioningRules::parse(other, "rules.yaml"));
  provisioner_->work();
  EXPECT_THAT(names(), ElementsAre("camera-2"));
  provisioner_->set_rules({});
  provisioner_->work();
  EXPECT_TRUE(running_.empty());
}

TEST_F(ProvisionerTest, forgets_what_a_finder_of_an_earlier_run_found_that_has_no_rule_any_more) {
  make(meters);
  tell({meter("1")});
  tell({}, {"1"});
  provisioner_->set_rules({});
  provisioner_->begin({id("house")});
  pass(1h);
  EXPECT_THAT(names(), IsEmpty());
}

}  // namespace
}  // namespace iotcloud::gateway
