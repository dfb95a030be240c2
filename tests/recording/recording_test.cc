#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/recording/recording.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::recording {
namespace {

using tests::TemporaryFolder;
using namespace std::chrono_literals;

RecordedChannel meter(int number, const std::string& channel = "reading") {
  return {
      "meter", "instance" + std::to_string(number),          "meter/" + std::to_string(number), "lab", channel, true,
      false,   {{"place", "room " + std::to_string(number)}}};
}

brokers::Message message_of(const RecordedChannel& channel, const std::string& payload, std::int64_t time_ms = 5) {
  brokers::Message message;
  message.payload = brokers::Payload::copy(payload);
  message.driver_id = channel.instance;
  message.gateway_id = channel.gateway;
  message.time_ms = time_ms;
  return message;
}

bool same(const brokers::Message& a, const brokers::Message& b) {
  return a.payload == b.payload && a.driver_id == b.driver_id && a.gateway_id == b.gateway_id &&
         a.time_ms == b.time_ms && a.properties == b.properties;
}

class Recording : public ::testing::Test {
 protected:
  const TemporaryFolder folder_;
  const std::string file_ = folder_ / "a.mcap";
};

TEST_F(Recording, OfAThousandChannelsGivesBackEachByteInOrder) {
  constexpr int channels = 1000, rounds = 20;
  std::vector<RecordedMessage> written;
  RecordingWriter writer(file_, {.compression = mcap::Compression::lz4, .chunk_bytes = 100'000});
  for (int i = 0; i < channels; ++i) writer.add_channel(meter(i));
  for (int round = 0; round < rounds; ++round) {
    for (int i = 0; i < channels; ++i) {
      const auto number = static_cast<std::size_t>(i);
      written.push_back(
          {number, Instant(1s + round * 1ms + i * 1us),
           message_of(meter(i), std::string(static_cast<std::size_t>(i % 50), static_cast<char>(round)))});
      if (i % 10 == 0) written.back().message.properties.set("round", std::to_string(round));
      writer.add(number, written.back().message, written.back().at);
    }
  }
  writer.close();
  RecordingReader reader(file_);
  reader.check();
  ASSERT_EQ(reader.channels().size(), std::size_t{channels});
  for (int i = 0; i < channels; ++i) {
    EXPECT_EQ(reader.channels()[static_cast<std::size_t>(i)], meter(i));
    EXPECT_EQ(reader.counts()[static_cast<std::size_t>(i)], std::uint64_t{rounds});
  }
  for (const auto& expected : written) {
    const auto read = reader.next();
    ASSERT_TRUE(read);
    ASSERT_TRUE(same(read->message, expected.message) && read->at == expected.at && read->channel == expected.channel);
  }
  EXPECT_FALSE(reader.next());
}

TEST_F(Recording, KeepsPropertiesAndTimesOfAnyKind) {
  std::vector<brokers::Message> written;
  for (const std::int64_t time :
       {std::int64_t{0}, std::int64_t{1'700'000'000'123}, std::int64_t{-7}, INT64_MAX, INT64_MIN})
    written.push_back(message_of(meter(1), "x", time));
  written.push_back(message_of(meter(1), ""));
  written.back().properties.set("b", "2");
  written.back().properties.set("a", std::string("\0\xff\n", 3));
  written.back().properties.set("", "");
  RecordingWriter writer(file_, {});
  writer.add_channel(meter(1));
  for (const auto& message : written) writer.add(0, message, 1s);
  writer.close();
  RecordingReader reader(file_);
  for (const auto& message : written) {
    const auto read = reader.next();
    ASSERT_TRUE(read);
    EXPECT_TRUE(same(read->message, message)) << message.time_ms;
  }
}

TEST_F(Recording, TellsTheSendersOnASharedChannelApart) {
  RecordedChannel shared{"meter", "", "", "lab", "reading", true, true};
  RecordingWriter writer(file_, {});
  writer.add_channel(shared);
  for (const char* sender : {"a", "b", "a"}) {
    auto message = message_of(shared, sender);
    message.driver_id = sender;
    writer.add(0, message, 1s);
  }
  writer.close();
  RecordingReader reader(file_);
  ASSERT_EQ(reader.channels().size(), 2u);
  EXPECT_EQ(reader.channels()[0].instance, "a");
  EXPECT_EQ(reader.counts()[0], 2u);
  EXPECT_EQ(reader.next()->message.driver_id, "a");
  EXPECT_EQ(reader.next()->message.driver_id, "b");
}

TEST_F(Recording, ThatIsFlushedSurvivesTheProcess) {
  {
    RecordingWriter writer(file_, {});
    writer.add_channel(meter(1));
    for (int i = 0; i < 10; ++i) writer.add(0, message_of(meter(1), std::to_string(i)), 1s);
    writer.flush();
    writer.add(0, message_of(meter(1), "lost"), 1s);
  }
  RecordingReader reader(file_);
  EXPECT_EQ(reader.counts(), std::vector<std::uint64_t>{10});
  EXPECT_FALSE(reader.file().whole());
}

TEST_F(Recording, OfAnotherProgramHasAChannelForEachTopic) {
  RecordingReader reader(std::string(RECORDINGS) + "/zstd.mcap");
  std::vector<std::string> names;
  for (const auto& channel : reader.channels()) names.push_back(channel.name);
  EXPECT_THAT(names, ::testing::ElementsAre("meter.1", "meter.2", "raw"));
  int count = 0;
  while (const auto message = reader.next()) {
    ++count;
    EXPECT_NEAR(static_cast<double>(message->message.time_ms), 1.7e12, 1000);
  }
  EXPECT_EQ(count, 30);
}

TEST_F(Recording, OfAnotherProgramTellsTopicsOfOneNameApart) {
  mcap::Writer writer(file_, {});
  for (const char* topic : {"/a", "a", "a.2", "//a", "a/b"}) writer.add_channel(0, topic, "", {});
  writer.add({0, 0, std::uint64_t{1} << 63, 0, "x"});
  writer.close();
  RecordingReader reader(file_);
  std::vector<std::string> names;
  for (const auto& channel : reader.channels()) names.push_back(channel.name);
  EXPECT_THAT(names, ::testing::ElementsAre("a", "a.2", "a.2.2", "a.3", "a.b"));
  EXPECT_EQ(reader.next()->at, Instant::max()) << "a time that nobody can have recorded";
  EXPECT_EQ(reader.start(), Instant::max());
}

TEST_F(Recording, KeepsFewPropertiesThatHaveNoMessage) {
  mcap::Writer writer(file_, {.profile = "iotcloud"});
  std::string properties;
  mcap::append(properties, mcap::Map{{"a", std::string(1'000'000, 'x')}});
  for (std::uint16_t i = 0; i < 20; ++i) {
    writer.add_channel(0, "/" + std::to_string(i), "iotcloud.properties",
                       {{"properties_of", std::to_string(1000 + i)}});
    writer.add({i, 0, i, 0, properties});
  }
  writer.close();
  RecordingReader reader(file_);
  EXPECT_THAT([&] { reader.next(); },
              ::testing::ThrowsMessage<RecordingError>(::testing::HasSubstr("properties without their messages")));
}

TEST_F(Recording, NamesAnInstanceByIdBeginningOrName) {
  auto channel = meter(3);
  EXPECT_TRUE(names_instance(channel, "instance3"));
  EXPECT_TRUE(names_instance(channel, "inst"));
  EXPECT_TRUE(names_instance(channel, "meter/3"));
  EXPECT_FALSE(names_instance(channel, "ins"));
  EXPECT_FALSE(names_instance(channel, "meter"));
  channel.alias.clear();
  EXPECT_FALSE(names_instance(channel, ""));
}

}  // namespace
}  // namespace iotcloud::recording
