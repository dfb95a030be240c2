#include <gmock/gmock.h>

#include <iotcloud/gateway/host/round_trips.h>

namespace iotcloud::gateway {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::Optional;
using Instant = config::Clock::Instant;

constexpr Instant begin{1h};

TEST(RoundTrips, TimesEachAnswerOnceFromItsMessage) {
  RoundTrips trips;
  EXPECT_EQ(trips.came(100, begin), std::nullopt) << "nothing was sent";
  trips.sent(100, begin);
  trips.sent(133, begin + 33ms);
  EXPECT_EQ(trips.came(101, begin + 40ms), std::nullopt) << "somebody else's";
  EXPECT_THAT(trips.came(133, begin + 40ms), Optional(7ms));
  EXPECT_THAT(trips.came(100, begin + 41ms), Optional(41ms)) << "answers may overtake each other";
  EXPECT_EQ(trips.came(100, begin + 42ms), std::nullopt) << "it is answered";
}

TEST(RoundTrips, MessagesOfOneMillisecondAreAnsweredInTurn) {
  RoundTrips trips;
  trips.sent(100, begin);
  trips.sent(100, begin + 400us);
  EXPECT_THAT(trips.came(100, begin + 2ms), Optional(2ms));
  EXPECT_THAT(trips.came(100, begin + 3ms), Optional(2600us));
}

TEST(RoundTrips, AMessageThatWasNotTakenHasNoAnswer) {
  RoundTrips trips;
  trips.sent(100, begin);
  trips.sent(100, begin + 1ms);
  trips.refused(100);
  trips.refused(99);
  EXPECT_THAT(trips.came(100, begin + 2ms), Optional(2ms));
  EXPECT_EQ(trips.came(100, begin + 3ms), std::nullopt);
}

TEST(RoundTrips, MessagesMayHaveAnOlderTimeThanThoseBefore) {
  RoundTrips trips;
  trips.sent(200, begin);
  trips.sent(100, begin + 1ms);
  EXPECT_THAT(trips.came(100, begin + 4ms), Optional(3ms));
  EXPECT_THAT(trips.came(200, begin + 4ms), Optional(4ms));
}

TEST(RoundTrips, AnAnswerCountsForAMinuteAndToTheLatestMessages) {
  RoundTrips trips;
  trips.sent(1, begin);
  trips.sent(2, begin + 1s);
  EXPECT_THAT(trips.came(1, begin + RoundTrips::longest), Optional(60s)) << "a late one counts as late";
  EXPECT_EQ(trips.came(2, begin + 1s + RoundTrips::longest + 1ms), std::nullopt);
  for (std::size_t i = 0; i < RoundTrips::most + 1; ++i) trips.sent(1000 + static_cast<std::int64_t>(i), begin + 2min);
  EXPECT_EQ(trips.came(1000, begin + 2min), std::nullopt);
  EXPECT_THAT(trips.came(1001, begin + 2min), Optional(0s));
}

/// The sample of an upper end; none of that end: one without a name.
const config::Sample& sample_of_end(const std::vector<config::Sample>& samples, const std::string& end) {
  static const config::Sample none;
  for (const auto& sample : samples) {
    if (sample.labels.at("le") == end) return sample;
  }
  return none;
}

TEST(RoundTrips, AreSamplesAsAHistogramOfPrometheus) {
  config::Histogram histogram;
  std::vector<config::Sample> samples;
  append_round_trips(histogram, "probe", samples);
  EXPECT_THAT(samples, IsEmpty()) << "a host without answers has none to show";
  histogram.record_ns(1'000'000);
  histogram.record_ns(1'000'000);
  histogram.record_ns(std::chrono::nanoseconds(40s).count());
  append_round_trips(histogram, "probe", samples);
  double before = 0;
  for (const auto& sample : samples) {
    EXPECT_EQ(sample.name, "iotcloud_driver_round_trip_seconds_bucket");
    EXPECT_EQ(sample.labels.at("plugin"), "probe");
    EXPECT_GE(sample.value, before);
    before = sample.value;
  }
  EXPECT_EQ(sample_of_end(samples, "+Inf").value, 3);
  EXPECT_EQ(sample_of_end(samples, "0.001048576").value, 2) << "2^20 ns";
  EXPECT_EQ(sample_of_end(samples, "0.000917504").value, 0);
}

TEST(CarriedMessages, AreAddedUpForEachHost) {
  std::vector<config::Sample> samples;
  const auto add = [&](const std::string& name, config::Labels labels, double value) {
    samples.push_back({.name = name, .help = "", .labels = std::move(labels), .value = value, .histogram = {}});
  };
  add("iotcloud_driver_messages_total", {{"host", "a"}, {"channel", "c"}, {"outcome", "confirmed"}}, 10);
  add("iotcloud_driver_messages_total", {{"host", "a"}, {"channel", "d"}, {"outcome", "confirmed"}}, 5);
  add("iotcloud_driver_messages_total", {{"host", "a"}, {"channel", "c"}, {"outcome", "would_block"}}, 7);
  add("iotcloud_driver_received_total", {{"host", "b"}}, 3);
  add("iotcloud_driver_broker_away", {{"host", "c"}}, 1);
  add(samples_age_metric, {{"host", "a"}}, 1.25);
  config::Histogram histogram;
  histogram.record_ns(1'000'000, 4);
  histogram.record_ns(3'000'000);
  std::vector<config::Sample> trips;
  append_round_trips(histogram, "one", trips);
  append_round_trips(histogram, "two", trips);
  for (auto& sample : trips) {
    sample.labels["host"] = "a";
    samples.push_back(sample);
  }
  discovery::CarriedMessages a{"a", 1250ms, 15, 0, {{1048.576, 8}, {3145.728, 2}}}, b{"b", 0ms, 0, 3};
  EXPECT_THAT(carried_messages(samples), ElementsAre(a, b)) << "c has carried nothing";
}

}  // namespace
}  // namespace iotcloud::gateway
