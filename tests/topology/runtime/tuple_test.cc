#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::AllOf;
using testing::HasSubstr;

TEST(Values, HoldWhatTheyAreMadeOf) {
  const Values values(1, 2U, 2.5, 3.5F, true, "text", std::string("string"), std::string_view("view"),
                      Payload::copy("bytes"), std::monostate());
  ASSERT_EQ(values.size(), 10U);
  EXPECT_EQ(std::get<std::int64_t>(values[1]), 2);
  EXPECT_EQ(std::get<double>(values[3]), 3.5);
  EXPECT_TRUE(std::get<bool>(values[4]));
  EXPECT_EQ(std::get<std::string>(values[5]), "text");
  EXPECT_EQ(std::get<std::string>(values[7]), "view");
  EXPECT_EQ(std::get<Payload>(values[8]).text(), "bytes");
  EXPECT_STREQ(kind_of(values[9]), "null");
}

TEST(Values, AreCopiedMovedAndAssignedBelowAndAboveTheInlineCapacity) {
  for (const int count : {0, 1, 4, 5, 9}) {
    Values original;
    for (int i = 0; i < count; ++i) original.add(Value("a string longer than fits inline " + std::to_string(i)));
    const auto expect_all = [&](const Values& values) {
      ASSERT_EQ(values.size(), static_cast<std::size_t>(count));
      for (int i = 0; i < count; ++i) {
        EXPECT_EQ(std::get<std::string>(values[static_cast<std::size_t>(i)]),
                  "a string longer than fits inline " + std::to_string(i));
      }
    };
    Values copy(original);
    expect_all(copy);
    expect_all(original);
    Values moved(std::move(copy));
    expect_all(moved);
    Values assigned(1, 2, 3, 4, 5, 6);
    assigned = moved;
    expect_all(assigned);
    assigned = Values(1);
    EXPECT_EQ(assigned.size(), 1U);
    assigned = std::move(moved);
    expect_all(assigned);
  }
}

/// The errors of wrong uses of a received tuple.
std::string error_of(const std::function<void(const Tuple&)>& use) {
  Bench bench;
  auto source = std::make_shared<Source>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source, {"name", "size"}));
  builder
      .set_bolt("uses", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  use(tuple);
                  out.ack(tuple);
                }))
      .shuffle_grouping("in");
  Runtime runtime(builder.build("tuple"), bench.options());
  runtime.start();
  source->put(Values("turtle", 7));
  runtime.run_until_idle();
  return runtime.snapshot().component("uses").last_error;
}

TEST(Tuple, IsReadByNameAndPosition) {
  EXPECT_EQ(error_of([](const Tuple& tuple) {
              EXPECT_EQ(tuple.get<std::string>("name"), "turtle");
              EXPECT_EQ(tuple.get<std::string_view>("name"), "turtle");
              EXPECT_EQ(tuple.get<std::string_view>(0).data(), tuple.get<std::string>(0).data()) << "no copy";
              EXPECT_EQ(tuple.get<std::int64_t>(1), 7);
              EXPECT_EQ(tuple.source_component(), "in");
              EXPECT_EQ(tuple.source_stream(), "default");
              EXPECT_EQ(tuple.source_task(), 1);
              EXPECT_FALSE(tuple.is_tick());
              EXPECT_TRUE(tuple.has("size"));
              EXPECT_FALSE(tuple.has("weight"));
            }),
            "");
}

TEST(Tuple, SaysWhatItHasWhenAskedForWhatItHasNot) {
  EXPECT_THAT(error_of([](const Tuple& tuple) { tuple.at("weight"); }),
              AllOf(HasSubstr("\"weight\""), HasSubstr("in/default"), HasSubstr("name, size")));
  EXPECT_THAT(error_of([](const Tuple& tuple) { tuple.at(2); }), HasSubstr("no field number 2"));
  EXPECT_THAT(error_of([](const Tuple& tuple) { tuple.get<double>("size"); }),
              AllOf(HasSubstr("\"size\""), HasSubstr("is of kind int, not double")));
  EXPECT_THAT(error_of([](const Tuple& tuple) { tuple.get<std::string_view>("size"); }),
              HasSubstr("is of kind int, not string"));
}

}  // namespace
}  // namespace iotcloud::topology::workshop
