#include <chrono>
#include <fstream>
#include <stdexcept>
#include <string>

#include <gtest/gtest.h>

#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/runtime/complete_topology.h>

using namespace iotcloud::topology;
using namespace std::chrono_literals;

extern "C" const LibraryDescriptor* iotcloud_topology_library();

/// Fails each line that ends with '?' once.
class Doubt : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"line"}); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const auto& line = tuple.get<std::string>("line");
    if (line.ends_with('?') && !doubted_) {
      doubted_ = true;
      throw std::runtime_error("really?");
    }
    collector.emit(Values(line));
  }

 private:
  bool doubted_ = false;
};

TEST(Lines, emits_a_line_again_that_failed_and_lines_that_are_added) {
  const std::string path = ::testing::TempDir() + "lines";
  std::ofstream file(path, std::ios::trunc);
  file << "one?\ntwo\n" << std::flush;
  ComponentRegistry components;
  iotcloud_topology_library()->fill(components);
  TopologyBuilder builder;
  builder.set_spout("lines", *components.spout("lines.Lines"), 1, {{"path", path}});
  builder.set_bolt<Doubt>("doubt").shuffle_grouping("lines");
  SimulatedTopology topology(builder.build("test"), {});
  topology.advance(1s);
  file << "three\n" << std::flush;
  topology.advance(1s);
  std::string lines;
  for (const auto& values : topology.tuples("doubt")) lines += std::get<std::string>(values[0]) + " ";
  EXPECT_EQ(lines, "one? two three ");
}
