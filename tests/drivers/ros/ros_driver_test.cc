// The driver against a real ROS master and a node of roscpp in another process. ctest runs each test in a process of
// its own, because roscpp allows one node in each.
#include <chrono>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <iotcloud/drivers/ros/ros_driver.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/servers/private_server.h>

namespace iotcloud::drivers::ros {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::Contains;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Matches;
using testing::MockInstance;

class Ros : public ::testing::Test {
 protected:
  Ros() { setenv("ROS_IP", "127.0.0.1", 1); }

  tests::PrivateServer& peer() {
    if (!peer_) {
      peer_ = std::make_unique<tests::PrivateServer>(
          "ros_peer.py", std::vector<std::string>{"--program", IOTCLOUD_ROS_PEER, "--master", master.url()});
    }
    return *peer_;
  }
  MockInstance& start(PropertyMap properties) {
    properties["ros_master"] = master.url();
    instance_ = std::make_unique<MockInstance>(describe<RosDriver>("ros", "test", true), std::move(properties));
    EXPECT_TRUE(instance_->start()) << instance_->error();
    return *instance_;
  }
  std::string seen(const std::string& key) { return instance_->host().metadata()[key]; }
  [[nodiscard]] bool see(const std::string& key, const std::string& text) {
    const bool has = until(*instance_, [&] { return seen(key).find(text) != std::string::npos; });
    EXPECT_TRUE(has) << key << ": " << seen(key);
    return has;
  }
  /// Messages of a channel that come from now on, at least so many.
  std::vector<Message> next(const std::string& channel, std::size_t count) {
    instance_->host().forget_published();
    EXPECT_TRUE(until_published(*instance_, channel, count)) << seen("ros") << seen("connection_problem");
    std::vector<Message> all;
    for (const auto& published : instance_->host().published(channel)) all.push_back(published.message);
    return all;
  }
  nlohmann::json json(const std::string& channel) { return nlohmann::json::parse(next(channel, 1)[0].payload.text()); }

  tests::PrivateServer master{"rosmaster.py"};

 private:
  std::unique_ptr<tests::PrivateServer> peer_;
  std::unique_ptr<MockInstance> instance_;
};

TEST_F(Ros, messages_of_any_type_become_json) {
  peer();
  start({{"subscribe", "odom=odometry, /image=image, /joints, /latched=latched"}});
  const auto where = json("odometry");
  EXPECT_EQ(where["header"]["stamp"], nlohmann::json::parse(R"({"secs":1700000000,"nsecs":5})"));
  EXPECT_EQ(where["header"]["frame_id"], "odom");
  EXPECT_EQ(where["pose"]["covariance"].size(), 36u);
  EXPECT_EQ(where["pose"]["covariance"][35], 0.25);
  EXPECT_TRUE(where["pose"]["pose"]["position"]["x"].is_number());
  const auto picture = json("image");
  EXPECT_EQ(picture["data"], "AAEC/f7/");
  EXPECT_EQ(picture["encoding"], "rgb8");
  const Message state = next("messages", 1)[0];
  EXPECT_EQ(*state.properties.find("topic"), "/joints");
  EXPECT_EQ(*state.properties.find("type"), "sensor_msgs/JointState");
  const auto joints = nlohmann::json::parse(state.payload.text());
  EXPECT_EQ(joints["name"], nlohmann::json::parse(R"(["knee","hip"])"));
  EXPECT_EQ(joints["position"], nlohmann::json::parse("[0.5,null]"));
}

TEST_F(Ros, a_latched_message_comes_once) {
  peer();
  MockInstance& instance = start({{"subscribe", "/latched=latched, /odom=odometry"}});
  ASSERT_TRUE(until_published(instance, "latched", 1));
  EXPECT_EQ(instance.host().published("latched")[0].message.payload.text(),
            "{\"data\":\"caf\xc3\xa9 \xef\xbf\xbd \\\"quoted\\\"\"}");
  // The node looks after topics that are silent for 5 s, and must not subscribe to them again.
  ASSERT_TRUE(until_published(instance, "odometry", 350));
  EXPECT_EQ(instance.host().published("latched").size(), 1u);
}

TEST_F(Ros, raw_messages_are_their_bytes) {
  peer();
  start({{"subscribe", "/image=image"}, {"format", "raw"}});
  const Message message = next("image", 1)[0];
  EXPECT_EQ(*message.properties.find("type"), "sensor_msgs/Image");
  EXPECT_EQ(*message.properties.find("md5sum"), "060021388200f6f0f447d0fcd9c64743");
  EXPECT_TRUE(message.payload.text().ends_with(std::string("\x06\0\0\0\0\x01\x02\xfd\xfe\xff", 10)));
}

TEST_F(Ros, json_commands_are_published_by_the_installed_definitions) {
  peer();
  MockInstance& instance = start({{"publish", "/cmd_vel=geometry_msgs/Twist, /say=std_msgs/String"},
                                  {"subscribe", "/heard=heard"},
                                  {"latch", "true"}});
  const auto say = [&](const std::string& text, const std::string& topic) {
    Message message = command(text);
    if (!topic.empty()) message.properties.set("topic", topic);
    ASSERT_TRUE(instance.deliver("publish", message));
  };
  const std::string velocity = R"({"data":"velocity 0.250000 -1.000000"})", good_day = R"({"data":"text good day"})";
  ASSERT_TRUE(see("ros", "is registered with"));
  // What is said before all connections are there is not heard.
  ASSERT_TRUE(until(instance, [&] {
    say(R"({"linear":{"x":0.25},"angular":{"z":-1}})", "/cmd_vel");
    say(R"({"data":"good day"})", "/say");
    const auto heard = texts(instance, "heard");
    return Matches(AllOf(Contains(velocity), Contains(good_day)))(heard);
  })) << seen("ros");
  EXPECT_THAT(texts(instance, "heard"), Each(AnyOf(velocity, good_day)));
  say(R"({"data":"good day"})", "");
  EXPECT_EQ(instance.host().logged_count("has several"), 1u);
  EXPECT_EQ(instance.host().logged_count("a message for ROS is lost"), 1u);
}

TEST_F(Ros, a_latched_command_reaches_who_comes_later) {
  MockInstance& instance =
      start({{"publish", "/say=std_msgs/String"}, {"subscribe", "/heard=heard"}, {"latch", "true"}});
  ASSERT_TRUE(see("ros", "nobody reads /say"));
  ASSERT_TRUE(instance.deliver("publish", command(R"({"data":"early"})")));
  peer();
  ASSERT_TRUE(until_published(instance, "heard", 1)) << seen("ros");
  EXPECT_EQ(texts(instance, "heard")[0], R"({"data":"text early"})");
}

TEST_F(Ros, says_why_a_command_is_lost) {
  MockInstance& instance = start({{"publish", "/cmd_vel=geometry_msgs/Twist"}});
  ASSERT_TRUE(see("ros", "nobody reads /cmd_vel"));
  ASSERT_TRUE(instance.deliver("publish", command(R"({"linear":{"w":1}})")));
  EXPECT_EQ(instance.host().logged_count("\"linear.w\" is no field of geometry_msgs/Vector3, which has x, y, z"), 1u);
}

TEST_F(Ros, raw_commands_are_their_bytes) {
  peer();
  MockInstance& instance =
      start({{"publish", "/say=std_msgs/String"}, {"subscribe", "/heard=heard"}, {"format", "raw"}, {"latch", "true"}});
  ASSERT_TRUE(see("ros", "is registered with"));
  ASSERT_TRUE(instance.deliver("publish", command(std::string("\x02\0\0\0hi!", 7))));
  EXPECT_EQ(instance.host().logged_count("1 bytes too many for std_msgs/String"), 1u);
  ASSERT_TRUE(until(instance, [&] {
    instance.deliver("publish", command(std::string("\x02\0\0\0hi", 6)));
    return !texts(instance, "heard").empty();
  })) << seen("ros");
  EXPECT_THAT(texts(instance, "heard"), Each(std::string("\x07\0\0\0text hi", 11)));
}

TEST_F(Ros, waits_for_its_master_and_outlives_it) {
  peer();
  master.kill();
  MockInstance& instance = start({{"subscribe", "/odom"}, {"publish", "/cmd_vel=geometry_msgs/Twist"}});
  ASSERT_TRUE(see("connection_problem", "waits for the ROS master at " + master.url() + ": Connection refused"));
  ASSERT_TRUE(instance.deliver("publish", command("{}")));
  EXPECT_EQ(instance.host().logged_count("there has been no ROS master yet"), 1u);
  master.start();  // it knows no node
  ASSERT_TRUE(see("ros", "nobody publishes /odom; nobody reads /cmd_vel"));
  EXPECT_EQ(seen("connection"), "connected");
  peer().kill();
  peer().start();
  next("messages", 3);
  master.kill();
  ASSERT_TRUE(see("connection_problem", "is away (Connection refused); what is connected goes on"));
  next("messages", 20);
  master.start();
  ASSERT_TRUE(see("ros", "is registered with"));
  next("messages", 20);
  peer().kill();  // the new master hears of the next one, and so must this node
  peer().start();
  next("messages", 20);
  EXPECT_FALSE(instance.host().failed());
}

TEST_F(Ros, a_publisher_that_was_killed_is_read_again) {
  MockInstance& instance = start({{"subscribe", "/odom"}});
  ASSERT_TRUE(see("ros", "nobody publishes /odom"));
  peer();
  next("messages", 5);
  peer().kill();
  peer().start();
  next("messages", 20);
  EXPECT_FALSE(instance.host().failed());
}

TEST_F(Ros, a_publisher_that_returns_at_the_same_address_is_read_again) {
  tests::PrivateServer camera("ros_camera.py", {"--master", master.url()});
  MockInstance& instance = start({{"subscribe", "/camera/depth/image_raw=depth"}, {"format", "raw"}});
  next("depth", 5);
  camera.kill();
  camera.start();
  next("depth", 5);
  EXPECT_FALSE(instance.host().failed());
}

TEST_F(Ros, refuses_what_it_cannot_read) {
  const tests::PrivateServer camera("ros_camera.py", {"--master", master.url()});  // it sends no definition
  MockInstance& instance = start({{"subscribe", "/camera/depth/image_raw=depth"}});
  ASSERT_TRUE(until(instance, [&] { return instance.host().logged_count("does not send the definition") > 0; }));
  EXPECT_THAT(instance.host().published("depth"), IsEmpty());
}

TEST_F(Ros, leaves_out_what_is_too_long) {
  peer();
  MockInstance& instance = start({{"subscribe", "/odom=odometry, /image=image"}, {"most_bytes", "300"}});
  ASSERT_TRUE(until_published(instance, "image", 3));
  ASSERT_TRUE(until(instance, [&] {
    return instance.host().logged_count("a message of /odom (nav_msgs/Odometry) is refused: it is longer than 300") > 0;
  }));
  EXPECT_THAT(instance.host().published("odometry"), IsEmpty());
}

TEST_F(Ros, keeps_the_newest_messages_while_a_channel_is_full) {
  peer();
  MockInstance& instance = start({{"subscribe", "/odom=odometry, /joints=joints"}, {"queue", "5"}});
  next("odometry", 1);
  instance.host().answer_publish("odometry", PublishStatus::would_block);
  ASSERT_TRUE(until(instance, [&] { return instance.host().logged_count("the channel is full (queue)") > 0; }));
  next("joints", 5);
  EXPECT_THAT(instance.host().published("odometry"), IsEmpty());
  instance.host().answer_publish("odometry", PublishStatus::accepted);
  instance.writable("odometry");
  ASSERT_TRUE(until_published(instance, "odometry", 8));
  const auto number = [&](std::size_t i) {
    const auto text = instance.host().published("odometry")[i].message.payload.text();
    return nlohmann::json::parse(text)["pose"]["pose"]["position"]["x"].get<int>();
  };
  // A queue of this length is roscpp's own, too, which drops what a busy machine takes too late.
  for (std::size_t i = 1; i < 8; ++i) EXPECT_GT(number(i), number(i - 1));
}

TEST_F(Ros, publishes_nothing_while_it_is_stopped) {
  peer();
  MockInstance& instance = start({{"subscribe", "/odom, /joints"}});
  next("messages", 1);
  ASSERT_TRUE(instance.deactivate());
  instance.host().run_posted();
  instance.host().forget_published();
  EXPECT_TRUE(until(instance, [&] { return seen("ros").find("is registered") != std::string::npos; }));
  EXPECT_THAT(instance.host().published(), IsEmpty());
  ASSERT_TRUE(instance.activate());
  next("messages", 2);
}

TEST_F(Ros, fails_when_its_node_is_told_to_end) {
  peer();
  MockInstance& instance = start({{"subscribe", "/odom"}});
  next("messages", 1);
  master.command("shutdown /iotcloud", "DONE");
  EXPECT_TRUE(tests::eventually([&] { return instance.host().failed(); }));
  EXPECT_THAT(instance.host().failure(), HasSubstr("rosnode kill"));
}

std::string refusal(PropertyMap properties) {
  MockInstance instance(describe<RosDriver>("ros", "test", true), std::move(properties));
  EXPECT_FALSE(instance.open());
  return instance.error() + instance.host().failure();
}

TEST(RosProperties, that_make_no_sense_are_refused) {
  EXPECT_THAT(refusal({}), AllOf(HasSubstr("\"subscribe\""), HasSubstr("\"publish\"")));
  EXPECT_THAT(refusal({{"subscribe", "/a"}, {"ros_master", "here"}}), HasSubstr("ros_master"));
  EXPECT_THAT(refusal({{"subscribe", "/a b"}}), AllOf(HasSubstr("\"subscribe\""), HasSubstr("/a b")));
  EXPECT_THAT(refusal({{"subscribe", "=x"}}), HasSubstr("names no topic"));
  EXPECT_THAT(refusal({{"subscribe", "/a="}}), HasSubstr("nothing behind"));
  EXPECT_THAT(refusal({{"subscribe", "/a, /a=b"}}), HasSubstr("twice"));
  EXPECT_THAT(refusal({{"subscribe", "/a=publish"}}), HasSubstr("any but \"publish\""));
  EXPECT_THAT(refusal({{"publish", "/a"}}), HasSubstr("TOPIC=TYPE"));
  EXPECT_THAT(refusal({{"publish", "/a=Twist"}}), AllOf(HasSubstr("/a=Twist"), HasSubstr("no type of messages")));
  EXPECT_THAT(refusal({{"publish", "/a=my_msgs/No"}, {"msg_path", "/no/such:/nor/this"}}),
              AllOf(HasSubstr("my_msgs/msg/No.msg"), HasSubstr("/no/such, /nor/this"), HasSubstr("msg_path")));
  EXPECT_THAT(refusal({{"subscribe", "/a"}, {"format", "xml"}}), HasSubstr("format"));
  EXPECT_THAT(refusal({{"subscribe", "/a"}, {"queue", "0"}}), HasSubstr("queue"));
  EXPECT_THAT(refusal({{"subscribe", "/a"}, {"topic", "/b"}}), HasSubstr("topic"));
}

}  // namespace
}  // namespace iotcloud::drivers::ros
