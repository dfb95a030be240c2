#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <libfreenect.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/drivers/turtle/recording/recording.h>
#include <iotcloud/tests/drivers/turtle/scratch_folder.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/servers/free_port.h>
#include <iotcloud/tests/system/trace.h>
#include <iotcloud/topology/local/local_cluster.h>

extern char** environ;

// The paper's set-up: a laptop on the robot, and gateway, broker and topology elsewhere. Kinects are replayed: this
// program and what it starts have libfreenect's replay in place of libfreenect.
namespace iotcloud::local {
namespace {

using drivers::turtle::ScratchFolder;
using tests::read_trace;
using Properties = std::map<std::string, std::string>;

/// iotcloud-robot, until the end of the scope.
class Laptop {
 public:
  explicit Laptop(std::vector<std::string> words) {
    words.insert(words.begin(), IOTCLOUD_ROBOT);
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    if (posix_spawn(&process_, IOTCLOUD_ROBOT, nullptr, nullptr, arguments.data(), environ) != 0) process_ = 0;
  }
  ~Laptop() {
    int status = 0;
    if (process_ == 0 || kill(process_, SIGTERM) != 0 || waitpid(process_, &status, 0) != process_) {
      ADD_FAILURE() << "iotcloud-robot did not start";
    } else {
      EXPECT_EQ(status, 0) << "iotcloud-robot did not end as it should";
    }
  }
  Laptop(const Laptop&) = delete;
  Laptop& operator=(const Laptop&) = delete;

 private:
  pid_t process_ = 0;
};

std::string free_address() {
  return "127.0.0.1:" + std::to_string(tests::free_port());
}

/// A cluster of this process with the follower and one turtle.
class FollowerCluster {
 public:
  FollowerCluster(const std::string& name, Properties turtle) : folder_(name) {
    LocalOptions options;
    options.name = name;
    options.plugin_dir = IOTCLOUD_TEST_PLUGINS;
    cluster_.emplace(options);
    cluster_->run_topology(IOTCLOUD_FOLLOWER_YAML);
    turtle["trace"] = trace();
    cluster_->deploy("turtle.so", turtle);
  }
  ~FollowerCluster() { EXPECT_TRUE(cluster_->stop(std::chrono::seconds(60))); }
  std::string trace() const { return folder_.file("trace.csv"); }
  /// Waits until so many frames were answered. \return the whole rows so far.
  std::vector<tests::Row> answered_rows(std::size_t count) {
    std::vector<tests::Row> rows;
    const auto enough = [&] {
      rows = read_trace(trace());
      std::erase_if(rows, [](const tests::Row& row) { return !row.contains("angular") || row.at("answered") != "1"; });
      return rows.size() >= count;
    };
    static_cast<void>(tests::eventually(enough, std::chrono::seconds(100)));
    return rows;
  }

 private:
  ScratchFolder folder_;
  std::optional<LocalCluster> cluster_;
};

TEST(RobotLaptop, FollowsThePersonThroughGatewayBrokerAndTopology) {
  const std::string address = free_address();
  constexpr std::size_t frames = 150;  // five seconds of the world, in lock step: as slow as the machine needs
  FollowerCluster cluster("laptop", {{"source", "robot"}, {"listen", address}, {"silence_ms", "60000"}});
  Laptop laptop({"--driver", address, "--source", "simulator", "--property", "clock=lockstep", "--property", "seed=3",
                 "--silence-ms", "60000"});
  auto rows = cluster.answered_rows(frames);
  ASSERT_GE(rows.size(), frames);
  rows.resize(frames);
  double error = 0;
  for (const auto& row : rows) {
    EXPECT_EQ(row.at("in_box"), "1") << "the person is lost at frame " << row.at("seq");
    error += std::abs(std::stod(row.at("error")));
  }
  EXPECT_NE(rows.front().at("robot_x"), rows.back().at("robot_x"));
  EXPECT_LT(error / frames, 0.25);
}

/// The shipped recording at 20 frames a second, for a minute.
void play_long(const ScratchFolder& folder) {
  const drivers::turtle::recording::Recording recording(IOTCLOUD_RECORDING);
  std::string index;
  for (std::size_t i = 0; i < 1200; ++i) {
    const auto& frame = recording.frames()[i % recording.frames().size()];
    const std::string name =
        "d-" + std::to_string(1 + 0.05 * static_cast<double>(i)) + "-" + std::to_string(i) + ".pgm";
    std::filesystem::create_symlink(recording.folder() / frame.file, folder.path() / name);
    index += name + "\n";
  }
  folder.write("INDEX.txt", index);
  setenv("FAKENECT_PATH", folder.path().c_str(), 1);
}

/// In the recording the person walks away from 0.75 m: the follower wants to come nearer.
void expect_to_follow(const std::vector<tests::Row>& rows, std::size_t count) {
  ASSERT_GE(rows.size(), count);
  for (const auto& row : rows) {
    EXPECT_GT(std::stod(row.at("linear")), 0.02) << "frame " << row.at("seq");
    EXPECT_LT(std::stod(row.at("linear")), 0.3) << "frame " << row.at("seq");
    EXPECT_GT(std::stod(row.at("latency_us")), 0);
  }
}

TEST(Fakenect, AKinectAtTheGatewayIsAnsweredByTheFollower) {
  // libfreenect is loaded, and it is the replay: the plugin, which is loaded later, gets the same.
  ASSERT_EQ(freenect_num_devices(nullptr), 1);
  ScratchFolder recording("kinect-recording");
  play_long(recording);
  FollowerCluster cluster("kinect", {{"source", "kinect"}});
  expect_to_follow(cluster.answered_rows(20), 20);
}

TEST(Fakenect, AKinectAtTheLaptopIsAnsweredByTheFollower) {
  ScratchFolder recording("laptop-recording");
  play_long(recording);
  setenv("LD_LIBRARY_PATH", IOTCLOUD_FAKENECT_DIR, 1);
  const std::string address = free_address();
  FollowerCluster cluster("laptop-kinect", {{"source", "robot"}, {"listen", address}, {"silence_ms", "60000"}});
  Laptop laptop({"--driver", address, "--source", "kinect", "--property", "codec=compact", "--silence-ms", "60000"});
  expect_to_follow(cluster.answered_rows(20), 20);
}

}  // namespace
}  // namespace iotcloud::local
