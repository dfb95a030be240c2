#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::AllOf;
using testing::HasSubstr;

/// A graph with one fault.
class Graph : public testing::Test {
 protected:
  Graph() { builder.set_spout("in", source_spout(std::make_shared<Source>(), {"key", "value"})); }
  template <typename Matcher>
  void expect_error(const std::string& component, const Matcher& text) {
    try {
      builder.build("graph");
      FAIL() << "build() must throw";
    } catch (const TopologyError& e) {
      EXPECT_EQ(e.component(), component);
      EXPECT_THAT(e.what(), text);
    }
  }
  TopologyBuilder builder;
};

TEST_F(Graph, PutsSourcesBeforeWhatTheyFeed) {
  builder.set_bolt("last", pass_bolt()).shuffle_grouping("middle");
  builder.set_bolt("middle", pass_bolt()).shuffle_grouping("in");
  const Topology topology = builder.build("graph");
  ASSERT_EQ(topology.components.size(), 3U);
  EXPECT_EQ(topology.components[0].id, "in");
  EXPECT_EQ(topology.components[1].id, "middle");
  EXPECT_EQ(topology.components[2].id, "last");
}

TEST_F(Graph, RefusesAnUnknownSource) {
  builder.set_bolt("out", pass_bolt()).shuffle_grouping("inn");
  expect_error("out", AllOf(HasSubstr("\"inn\""), HasSubstr("there are: in, out")));
}

TEST_F(Graph, RefusesAnUnknownStream) {
  builder.set_bolt("out", pass_bolt()).shuffle_grouping("in", "errors");
  expect_error("out", AllOf(HasSubstr("\"errors\""), HasSubstr("default")));
}

TEST_F(Graph, RefusesAKeyThatTheSourceDoesNotDeclare) {
  builder.set_bolt("out", pass_bolt()).fields_grouping("in", {"kye"});
  expect_error("out", AllOf(HasSubstr("\"kye\""), HasSubstr("key, value")));
}

TEST_F(Graph, RefusesABoltWithoutInput) {
  builder.set_bolt("out", pass_bolt());
  expect_error("out", HasSubstr("has no input"));
}

TEST_F(Graph, NamesTheCycle) {
  builder.set_bolt("a", pass_bolt()).shuffle_grouping("in").shuffle_grouping("c");
  builder.set_bolt("b", pass_bolt()).shuffle_grouping("a");
  builder.set_bolt("c", pass_bolt()).shuffle_grouping("b");
  try {
    builder.build("graph");
    FAIL() << "build() must throw";
  } catch (const TopologyError& e) {
    EXPECT_THAT(e.what(), testing::AnyOf(HasSubstr("a -> b -> c -> a"), HasSubstr("b -> c -> a -> b"),
                                         HasSubstr("c -> a -> b -> c")));
  }
}

TEST_F(Graph, RefusesTwoComponentsOfOneIdAndReservedIds) {
  EXPECT_THROW(builder.set_bolt("in", pass_bolt()), TopologyError);
  EXPECT_THROW(builder.set_bolt("__system", pass_bolt()), TopologyError);
  EXPECT_THROW(builder.set_bolt("", pass_bolt()), TopologyError);
}

TEST_F(Graph, RefusesParallelismBelowOne) {
  try {
    builder.set_bolt("out", pass_bolt(), 0);
    FAIL() << "set_bolt() must throw";
  } catch (const TopologyError& e) {
    EXPECT_EQ(e.component(), "out");
    EXPECT_THAT(e.what(), HasSubstr("parallelism 0"));
  }
}

TEST_F(Graph, RefusesAKeyedGroupingWithoutKeyAndAGroupingThatIsNone) {
  EXPECT_THROW(builder.set_bolt("out", pass_bolt()).grouping("sorted", "in", {}, default_stream), TopologyError);
  builder.bolt("out").fields_grouping("in", {});
  expect_error("out", HasSubstr("needs the fields"));
}

TEST_F(Graph, RefusesDirectGroupingOfAStreamThatIsNotDirect) {
  builder.set_bolt("out", pass_bolt()).direct_grouping("in");
  expect_error("out", HasSubstr("not declared direct"));
}

TEST(GraphAsAWhole, NeedsASpout) {
  TopologyBuilder builder;
  EXPECT_THROW(builder.build("empty"), TopologyError);
}

TEST_F(Graph, SaysWhichComponentCannotBeMade) {
  builder.set_bolt("out", []() -> std::unique_ptr<Bolt> { throw std::runtime_error("no licence"); })
      .shuffle_grouping("in");
  expect_error("out", HasSubstr("no licence"));
}

}  // namespace
}  // namespace iotcloud::topology::workshop
