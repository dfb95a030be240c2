#include <cstdint>
#include <optional>
#include <string>
#include <variant>

#include <gtest/gtest.h>

#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/runtime/complete_topology.h>

using namespace iotcloud::topology;

extern "C" const LibraryDescriptor* iotcloud_topology_library();  // what IOTCLOUD_TOPOLOGY_LIBRARY exports

/// Stands for the spout: the test says what it emits.
class Lines : public Spout {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"line"}); }
  void open(const Config&, const TopologyContext&, SpoutOutputCollector&) override {}
  bool next_tuple() override { return false; }
};

TEST(Words, are_counted) {
  ComponentRegistry components;
  iotcloud_topology_library()->fill(components);
  TopologyBuilder builder;
  builder.set_spout<Lines>("lines");
  builder.set_bolt("split", *components.bolt("words.Split")).shuffle_grouping("lines");
  builder.set_bolt("count", *components.bolt("words.Count")).fields_grouping("split", {"word"});
  SimulatedTopology topology(builder.build("test"), SimulatedTopology::Options{.inputs = {"lines"}});
  topology.put("lines", Values("to be or not to be"));
  const auto counts = topology.tuples("count");
  ASSERT_EQ(counts.size(), 6u);
  EXPECT_EQ(std::get<std::string>(counts.back()[0]), "be");
  EXPECT_EQ(std::get<std::int64_t>(counts.back()[1]), 2);
}
