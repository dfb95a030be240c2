#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/topology/local/local_cluster.h>

namespace iotcloud::local {
namespace {

using Row = std::map<std::string, std::string>;

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> words;
  std::istringstream stream(line);
  for (std::string word; std::getline(stream, word, ',');) words.push_back(word);
  return words;
}

/// The whole rows of a trace (drivers/turtle/README.md), by column name.
std::vector<Row> read_trace(const std::filesystem::path& path) {
  std::vector<Row> rows;
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line)) return rows;
  const auto names = split(line);
  while (std::getline(file, line)) {
    const auto words = split(line);
    Row row;
    for (std::size_t i = 0; i < words.size() && i < names.size(); ++i) row[names[i]] = words[i];
    rows.push_back(std::move(row));
  }
  return rows;
}

/// The demo's parts, the world in lock step with the commands: as slow as the machine needs, and the same each time.
TEST(ClosedLoop, TheRobotFollowsThePersonThroughGatewayBrokerAndTopology) {
  constexpr std::size_t frames = 300;  // ten seconds of the world
  const auto trace = std::filesystem::temp_directory_path() / ("closed_loop_" + std::to_string(getpid()) + ".csv");
  LocalOptions options;
  options.name = "closed-loop";
  options.plugin_dir = IOTCLOUD_TEST_PLUGINS;
  LocalCluster cluster(options);
  cluster.run_topology(IOTCLOUD_FOLLOWER_YAML);
  const auto instance = cluster.deploy("turtle.so", {{"clock", "lockstep"}, {"seed", "3"}, {"trace", trace.string()}});
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(100);
  while (read_trace(trace).size() < frames && std::chrono::steady_clock::now() < deadline) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  cluster.undeploy(instance);
  EXPECT_TRUE(cluster.stop(std::chrono::seconds(5)));

  auto rows = read_trace(trace);
  std::filesystem::remove(trace);
  ASSERT_GE(rows.size(), frames);
  rows.resize(frames);  // the last one may have been under way when we stopped
  double error = 0;
  bool moved = false;
  for (const auto& row : rows) {
    EXPECT_EQ(row.at("answered"), "1") << "frame " << row.at("seq");
    EXPECT_EQ(row.at("in_box"), "1") << "the person is lost at frame " << row.at("seq");
    error += std::abs(std::stod(row.at("error")));
    moved = moved || row.at("robot_x") != rows.front().at("robot_x");
  }
  EXPECT_TRUE(moved);
  EXPECT_LT(error / frames, 0.25);
}

}  // namespace
}  // namespace iotcloud::local
