#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/system/trace.h>
#include <iotcloud/topology/local/local_cluster.h>

namespace iotcloud::local {
namespace {

using tests::read_trace;
using tests::Row;

/// A trace of this process's own that is gone afterwards.
class Trace {
 public:
  explicit Trace(const std::string& name)
      : path_(std::filesystem::temp_directory_path() / (name + "_" + std::to_string(getpid()) + ".csv")) {}
  ~Trace() { std::filesystem::remove(path_); }
  Trace(const Trace&) = delete;
  Trace& operator=(const Trace&) = delete;
  std::string path() const { return path_.string(); }

  /// The first `frames` rows, or as many as came within 100 s.
  std::vector<Row> wait_for(std::size_t frames) const {
    static_cast<void>(tests::eventually([&] { return read_trace(path_).size() >= frames; }, std::chrono::seconds(100)));
    auto rows = read_trace(path_);
    if (rows.size() > frames) rows.resize(frames);  // later ones may be under way when we stop
    return rows;
  }

 private:
  std::filesystem::path path_;
};

LocalOptions local_options(const std::string& name) {
  LocalOptions options;
  options.name = name;
  options.plugin_dir = IOTCLOUD_TEST_PLUGINS;
  return options;
}

void expect_followed(const std::vector<Row>& rows, std::size_t frames) {
  ASSERT_EQ(rows.size(), frames);
  double error = 0;
  bool moved = false;
  for (const auto& row : rows) {
    EXPECT_EQ(row.at("answered"), "1") << "frame " << row.at("seq");
    EXPECT_EQ(row.at("in_box"), "1") << "the person is lost at frame " << row.at("seq");
    error += std::abs(std::stod(row.at("error")));
    moved = moved || row.at("robot_x") != rows.front().at("robot_x");
  }
  EXPECT_TRUE(moved);
  EXPECT_LT(error / static_cast<double>(frames), 0.25);
}

/// The demo's parts, the world in lock step with the commands: as slow as the machine needs, and the same each time.
TEST(ClosedLoop, TheRobotFollowsThePersonThroughGatewayBrokerAndTopology) {
  constexpr std::size_t frames = 300;  // ten seconds of the world
  const Trace trace("closed_loop");
  LocalCluster cluster(local_options("closed-loop"));
  cluster.run_topology(IOTCLOUD_FOLLOWER_YAML);
  const auto instance = cluster.deploy("turtle.so", {{"clock", "lockstep"}, {"seed", "3"}, {"trace", trace.path()}});
  const auto rows = trace.wait_for(frames);
  cluster.undeploy(instance);
  EXPECT_TRUE(cluster.stop(std::chrono::seconds(60)));
  expect_followed(rows, frames);
}

TEST(ClosedLoop, OneTopologyFollowsRobotsWhoseFramesHaveDifferentCodecs) {
  constexpr std::size_t frames = 60;  // two seconds of the world
  const std::map<std::string, std::string> properties = {{"clock", "lockstep"}, {"seed", "3"}};
  const std::vector<std::string> codecs = {"reference", "compact", "lossless"};
  LocalCluster cluster(local_options("codecs"));
  cluster.run_topology(IOTCLOUD_FOLLOWER_YAML);
  std::map<std::string, std::vector<Row>> rows;
  {
    std::map<std::string, Trace> traces;
    std::map<std::string, discovery::InstanceId> instances;
    for (const auto& codec : codecs) {
      const Trace& trace = traces.try_emplace(codec, "closed_loop_" + codec).first->second;
      auto with_codec = properties;
      with_codec["codec"] = codec;
      with_codec["trace"] = trace.path();
      instances[codec] = cluster.deploy("turtle.so", with_codec);
    }
    for (const auto& codec : codecs) {  // the fastest first; a robot that has run far enough leaves the CPUs to others
      rows[codec] = traces.at(codec).wait_for(frames);
      cluster.undeploy(instances[codec]);
    }
    EXPECT_TRUE(cluster.stop(std::chrono::seconds(60)));
  }
  for (const auto& codec : codecs) {
    SCOPED_TRACE(codec);
    expect_followed(rows[codec], frames);
  }
  ASSERT_EQ(rows["compact"].size(), rows["reference"].size());
  for (std::size_t i = 0; i < rows["reference"].size(); ++i) {
    // The same depths, so the same commands and the same world, to the last digit.
    for (const char* column : {"robot_x", "robot_y", "person_x", "linear", "angular"}) {
      ASSERT_EQ(rows["compact"][i].at(column), rows["reference"][i].at(column)) << column << " of frame " << i;
    }
    EXPECT_LT(2 * std::stoi(rows["compact"][i].at("payload_bytes")),
              std::stoi(rows["reference"][i].at("payload_bytes")));
  }
}

}  // namespace
}  // namespace iotcloud::local
