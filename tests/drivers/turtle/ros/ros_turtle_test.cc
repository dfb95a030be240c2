// turtle_ros.so in local mode against a real ROS master. The robot is a ROS node in a separate process, because roscpp
// allows one node per process.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/local/local_cluster.h>

namespace iotcloud::tests {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;

using Row = std::map<std::string, double>;

/// The commands to the robot's base and its moves (robot_main.cc), as complete rows.
std::vector<Row> rows_of(const std::string& trace) {
  std::istringstream text(read_file(trace));
  std::vector<std::string> names;
  std::vector<Row> rows;
  for (std::string line; std::getline(text, line);) {
    std::istringstream words(line);
    std::vector<std::string> fields;
    for (std::string field; std::getline(words, field, ',');) fields.push_back(field);
    if (names.empty()) {
      names = fields;
    } else if (fields.size() == names.size() && !text.eof()) {
      auto& row = rows.emplace_back();
      for (std::size_t i = 0; i < fields.size(); ++i) row[names[i]] = std::strtod(fields[i].c_str(), nullptr);
    }
  }
  return rows;
}

/// The odometry that came through the broker, newest last.
class Heard {
 public:
  static Heard& get() {
    static Heard heard;
    return heard;
  }
  void add(std::string text) {
    const std::lock_guard lock(mutex_);
    texts_.push_back(std::move(text));
  }
  std::vector<std::string> all() const {
    const std::lock_guard lock(mutex_);
    return texts_;
  }

 private:
  mutable std::mutex mutex_;
  std::vector<std::string> texts_;
};

class Listen : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer&) const override {}
  void execute(const topology::Tuple& tuple, topology::BasicOutputCollector&) override {
    Heard::get().add(std::string(std::get<brokers::Payload>(tuple.at("odometry")).text()));
  }
};

constexpr const char* odometry_topology = R"(
topology.name: odometry
spouts:
  receive: {broker: rabbitmq, driver: turtle, channel: odometry, fields: [odometry, driverID, time]}
bolts:
  listen: {class: test.Listen, inputs: [{from: receive, grouping: fields, fields: [driverID]}]}
)";

class RosTurtle : public ::testing::Test {
 protected:
  RosTurtle() {
    setenv("ROS_IP", "127.0.0.1", 1);
    local::LocalOptions options;
    options.name = "ros";
    options.plugin_dir = IOTCLOUD_TEST_PLUGINS;
    cluster = std::make_unique<local::LocalCluster>(options);
    cluster->run_topology(IOTCLOUD_FOLLOWER_YAML);
  }

  discovery::InstanceId deploy(std::map<std::string, std::string> more = {}) {
    more.merge(std::map<std::string, std::string>{{"source", "ros"},
                                                  {"ros_master", master.url()},
                                                  {"velocity_topic", "/cmd_vel_mux/input/navi"},
                                                  // The world is in lock step: as fast or slow as the machine.
                                                  {"rate", "120"},
                                                  {"watchdog_ms", "10000"}});
    return cluster->deploy("turtle_ros.so", more);
  }
  /// The metadata of the only instance.
  std::string seen(const std::string& key) const {
    const auto drivers = cluster->master().drivers();
    if (drivers.size() != 1) return {};
    const auto found = drivers.front().metadata.find(key);
    return found == drivers.front().metadata.end() ? "" : found->second;
  }
  [[nodiscard]] bool see(const std::string& key, const std::string& text) const {
    const bool seen_it = eventually([&] { return seen(key).find(text) != std::string::npos; });
    EXPECT_TRUE(seen_it) << key << ": " << seen(key);
    return seen_it;
  }
  void start_robot() {
    robot = std::make_unique<PrivateServer>(
        "ros_robot.py", std::vector<std::string>{"--program", IOTCLOUD_ROS_ROBOT, "--master", master.url(),
                                                 "--lockstep", "--seed", "3"});
  }
  Row newest() const { return rows_of(robot->url()).back(); }
  /// Expects this many commands, a robot that stays near the person all the time, and this distance.
  void expect_following(double commands, double metres = 0) {
    ASSERT_TRUE(robot);
    ASSERT_TRUE(eventually([&] { return newest().at("commands") >= commands; }))
        << "ros: " << seen("ros") << "; ros_images: " << seen("ros_images");
    const auto rows = rows_of(robot->url());
    double error = 0;
    for (const Row& row : rows) {
      ASSERT_EQ(row.at("in_box"), 1) << "the person is lost at command " << row.at("commands");
      error += std::abs(row.at("distance") - 0.7);
    }
    EXPECT_LT(error / static_cast<double>(rows.size()), 0.25);
    EXPECT_GE(std::hypot(rows.back().at("x") - rows.front().at("x"), rows.back().at("y") - rows.front().at("y")),
              metres);
  }

  PrivateServer master{"rosmaster.py"};
  std::unique_ptr<PrivateServer> robot;
  std::unique_ptr<local::LocalCluster> cluster;
};

TEST_F(RosTurtle, follows_the_person_by_millimetres_and_tells_odometry) {
  topology::ComponentRegistry components;
  components.add_bolt<Listen>("test.Listen");
  cluster->run_topology(topology::TopologyDefinition::parse(odometry_topology, "odometry.yaml"), std::move(components));
  start_robot();
  const auto instance = deploy({{"odometry_topic", "odom"}});
  expect_following(150, 0.3);
  ASSERT_TRUE(eventually([&] { return Heard::get().all().size() >= 100; }));
  const auto odometry = nlohmann::json::parse(Heard::get().all().back());
  const auto rows = rows_of(robot->url());
  EXPECT_TRUE(std::any_of(rows.begin(), rows.end(), [&](const Row& row) {
    return std::hypot(odometry["position"]["x"].get<double>() - row.at("x"),
                      odometry["position"]["y"].get<double>() - row.at("y")) < 0.001;
  })) << odometry;
  EXPECT_EQ(odometry["frame"], "odom");
  EXPECT_GT(odometry["stamp_ms"].get<double>(), 1.5e12);
  EXPECT_NEAR(std::sin(odometry["heading"].get<double>() / 2), odometry["orientation"]["z"].get<double>(), 1e-6);
  EXPECT_TRUE(odometry["linear"].contains("x") && odometry["angular"].contains("z"));
  EXPECT_TRUE(see("ros", "is registered with the ROS master at " + master.url()));
  cluster->undeploy(instance);
  EXPECT_TRUE(eventually([&] { return newest().at("asked_linear") == 0; }))
      << "the last command does not stop the robot";
}

TEST_F(RosTurtle, follows_the_person_by_metres) {
  start_robot();
  deploy({{"depth_topic", "/camera/depth/image"}});
  expect_following(150, 0.3);
}

TEST_F(RosTurtle, waits_for_its_master_and_outlives_it) {
  master.kill();
  const auto instance = deploy();  // it is active and reports what is missing
  ASSERT_TRUE(see("ros", "waits for the ROS master at " + master.url() + ": Connection refused"));
  master.start();
  ASSERT_TRUE(see("ros", "nobody publishes /camera/depth/image_raw; nobody reads /cmd_vel_mux/input/navi"));
  start_robot();
  expect_following(30);

  master.kill();
  ASSERT_TRUE(see("ros", "is away (Connection refused); what is connected goes on"));
  const double before = newest().at("commands");
  expect_following(before + 30);
  master.start();  // it knows no node, and no node tells it of the robot
  ASSERT_TRUE(see("ros", "is registered with"));
  expect_following(newest().at("commands") + 30);

  robot.reset();
  ASSERT_TRUE(see("ros", "no image comes on /camera/depth/image_raw; nobody reads /cmd_vel_mux/input/navi"));
  start_robot();
  expect_following(30);
  cluster->undeploy(instance);

  // Once more in the same process.
  start_robot();
  deploy();
  expect_following(30);
}

TEST_F(RosTurtle, hears_a_camera_that_was_started_again_at_the_same_address) {
  PrivateServer camera("ros_camera.py", {"--master", master.url()});
  deploy();
  const std::string heard = "; nobody reads /cmd_vel_mux/input/navi";
  ASSERT_TRUE(see("ros", "is registered with the ROS master at " + master.url() + heard));
  camera.kill();
  ASSERT_TRUE(see("ros", "no image comes on /camera/depth/image_raw"));
  camera.start();
  EXPECT_TRUE(see("ros", "is registered with the ROS master at " + master.url() + heard));
}

TEST_F(RosTurtle, refuses_images_that_show_no_depth) {
  start_robot();
  deploy({{"depth_topic", "/camera/rgb/image_raw"}});
  ASSERT_TRUE(see("ros_images", "refused: its encoding is \"rgb8\"; a depth image has 16UC1"));
  EXPECT_EQ(newest().at("commands"), 0);
}

TEST_F(RosTurtle, ends_while_its_master_hangs) {
  start_robot();
  const auto instance = deploy();
  expect_following(10);
  master.pause();
  ASSERT_TRUE(see("ros", "is away (it does not answer)"));
  cluster->undeploy(instance);
  EXPECT_THAT(cluster->master().drivers(), ::testing::IsEmpty());
  master.resume();
}

TEST_F(RosTurtle, fails_when_its_node_is_told_to_shut_down) {
  const auto instance = deploy();
  ASSERT_TRUE(see("ros", "is registered with"));
  master.command("shutdown /iotcloud_turtle", "DONE");
  const auto record = [&] { return cluster->master().drivers().at(0); };
  // Its gateway starts it again before long, and says then why it had failed.
  EXPECT_TRUE(eventually([&] { return record().reason.find("rosnode kill") != std::string::npos; }));
  cluster->undeploy(instance);
  start_robot();
  deploy();
  expect_following(10);
}

TEST_F(RosTurtle, has_a_process_for_itself) {
  deploy();
  try {
    deploy();
    FAIL() << "two ROS nodes in one process";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("one to a process"), HasSubstr("isolation=instance")));
  }
}

TEST_F(RosTurtle, says_which_property_is_wrong) {
  const auto error_with = [&](const std::map<std::string, std::string>& properties) -> std::string {
    try {
      deploy(properties);
    } catch (const config::Error& error) {
      return error.what();
    }
    return "nothing is wrong";
  };
  EXPECT_THAT(error_with({{"ros_master", "localhost"}}), AllOf(HasSubstr("ros_master"), HasSubstr("http://")));
  EXPECT_THAT(error_with({{"ros_master", "http://localhost:port"}}), HasSubstr("http://localhost:11311"));
  EXPECT_THAT(error_with({{"depth_topic", "/camera depth"}}), AllOf(HasSubstr("depth_topic"), HasSubstr("ROS topic")));
  EXPECT_THAT(error_with({{"odometry", "/odom"}}), AllOf(HasSubstr("\"odometry\""), HasSubstr("odometry_topic")));
}

}  // namespace
}  // namespace iotcloud::tests
