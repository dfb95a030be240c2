#include <filesystem>
#include <fstream>
#include <iterator>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>

#include <iotcloud/recording/error.h>
#include <iotcloud/recording/mcap/reader.h>
#include <iotcloud/recording/mcap/writer.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::recording::mcap {
namespace {

using ::testing::HasSubstr;
using tests::TemporaryFolder;

std::string bytes_of(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}
void write(const std::string& file, const std::string& bytes) {
  std::ofstream(file, std::ios::binary) << bytes;
}

/// A message whose bytes are its own.
struct Kept {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time = 0, publish_time = 0;
  std::string data{};
  friend bool operator==(const Kept&, const Kept&) = default;
};

std::vector<Kept> all(Reader& reader) {
  std::vector<Kept> messages;
  while (const auto message = reader.next())
    messages.push_back(
        {message->channel, message->sequence, message->log_time, message->publish_time, std::string(message->data)});
  return messages;
}

/// The checksum, bit by bit: another way than the writer's.
std::uint32_t slow_crc(std::string_view bytes) {
  std::uint32_t crc = 0xFFFFFFFF;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int i = 0; i < 8; ++i) crc = (crc >> 1) ^ ((crc & 1U) != 0 ? 0xEDB88320U : 0U);
  }
  return ~crc;
}

std::string little(std::uint64_t number, int bytes) {
  std::string text;
  for (int i = 0; i < bytes; ++i) text.push_back(static_cast<char>(number >> (8 * i)));
  return text;
}
std::string text(const std::string& value) {
  return little(value.size(), 4) + value;
}
std::string record(int opcode, const std::string& content) {
  return static_cast<char>(opcode) + little(content.size(), 8) + content;
}

/// What the specification says of a file with one channel and one chunk of two messages, put together by hand.
std::string by_hand() {
  const std::string head = "\x89MCAP0\r\n" + record(0x01, text("p") + text("iotcloud"));
  const std::string channel = record(0x04, little(0, 2) + little(0, 2) + text("/a") + text("json") +
                                               little(text("k").size() + text("v").size(), 4) + text("k") + text("v"));
  const std::string first = record(0x05, little(0, 2) + little(7, 4) + little(100, 8) + little(90, 8) + "one");
  const std::string second = record(0x05, little(0, 2) + little(8, 4) + little(200, 8) + little(190, 8) + "two");
  const std::string messages = first + second;
  const std::string chunk =
      record(0x06, little(100, 8) + little(200, 8) + little(messages.size(), 8) + little(slow_crc(messages), 4) +
                       text("") + little(messages.size(), 8) + messages);
  const std::string index = record(
      0x07, little(0, 2) + little(32, 4) + little(100, 8) + little(0, 8) + little(200, 8) + little(first.size(), 8));
  const std::string data = head + channel + chunk + index;
  const std::uint64_t chunk_at = head.size() + channel.size();
  const std::string data_end = record(0x0F, little(slow_crc(data), 4));
  const std::string statistics =
      record(0x0B, little(2, 8) + little(0, 2) + little(1, 4) + little(0, 4) + little(0, 4) + little(1, 4) +
                       little(100, 8) + little(200, 8) + little(10, 4) + little(0, 2) + little(2, 8));
  const std::string chunk_index =
      record(0x08, little(100, 8) + little(200, 8) + little(chunk_at, 8) + little(chunk.size(), 8) + little(10, 4) +
                       little(0, 2) + little(chunk_at + chunk.size(), 8) + little(index.size(), 8) + text("") +
                       little(messages.size(), 8) + little(messages.size(), 8));
  const std::uint64_t summary = data.size() + data_end.size();
  std::uint64_t at = summary;
  std::string offsets;
  for (const auto& [opcode, group] : {std::pair(0x04, channel), {0x0B, statistics}, {0x08, chunk_index}}) {
    offsets += record(0x0E, static_cast<char>(opcode) + little(at, 8) + little(group.size(), 8));
    at += group.size();
  }
  const std::string before_crc =
      channel + statistics + chunk_index + offsets + '\x02' + little(20, 8) + little(summary, 8) + little(at, 8);
  return data + data_end + before_crc + little(slow_crc(before_crc), 4) + "\x89MCAP0\r\n";
}

void write_by_hand_with(Writer& writer) {
  writer.add_channel(0, "/a", "json", {{"k", "v"}});
  writer.add({0, 7, 100, 90, "one"});
  writer.add({0, 8, 200, 190, "two"});
}

TEST(McapWriter, WritesWhatTheSpecificationSaysByteForByte) {
  const TemporaryFolder folder;
  Writer writer(folder / "a.mcap", {.profile = "p", .compression = Compression::none});
  write_by_hand_with(writer);
  writer.close();
  EXPECT_EQ(bytes_of(folder / "a.mcap"), by_hand());
}

TEST(McapReader, ReadsWhatTheSpecificationSays) {
  const TemporaryFolder folder;
  write(folder / "a.mcap", by_hand());
  Reader reader(folder / "a.mcap");
  EXPECT_EQ(reader.problem(), "");
  EXPECT_EQ(reader.header().profile, "p");
  EXPECT_EQ(reader.channels().at(0).topic, "/a");
  EXPECT_EQ(value_of(reader.channels().at(0).metadata, "k"), "v");
  EXPECT_EQ(all(reader), (std::vector<Kept>{{0, 7, 100, 90, "one"}, {0, 8, 200, 190, "two"}}));
  reader.check();
}

class McapFiles : public ::testing::TestWithParam<const char*> {};

TEST_P(McapFiles, OfAnotherProgramAreReadInOrderOfTime) {
  Reader reader(std::string(RECORDINGS) + "/" + GetParam() + ".mcap");
  reader.check();
  EXPECT_TRUE(reader.whole()) << reader.problem();
  EXPECT_EQ(reader.header().profile, "test");
  EXPECT_EQ(reader.schemas().at(1).data, R"({"type": "object"})");
  ASSERT_EQ(reader.metadata().size(), 1u);
  EXPECT_EQ(value_of(reader.metadata()[0].entries, "city"), "Bloomington");
  const auto messages = all(reader);
  ASSERT_EQ(messages.size(), 30u);
  std::set<std::uint32_t> sequences;
  for (std::size_t i = 0; i < messages.size(); ++i) {
    const auto& message = messages[i];
    EXPECT_TRUE(i == 0 || messages[i - 1].log_time <= message.log_time);
    sequences.insert(message.sequence);
    const std::uint64_t late = message.sequence % 3 == 2 ? 5'000'000 : 0;
    EXPECT_EQ(message.log_time, 1'700'000'000'000'000'000 + message.sequence * std::uint64_t{1'000'000} - late);
    EXPECT_EQ(message.publish_time, message.log_time - 1000);
    if (reader.channels().at(message.channel).topic == "/raw") {
      EXPECT_EQ(message.data.size(), message.sequence);
    } else {
      EXPECT_EQ(message.data, "{\"value\": " + std::to_string(message.sequence) + "}");
    }
  }
  EXPECT_EQ(sequences.size(), 30u);
  reader.rewind();
  EXPECT_EQ(all(reader), messages);
}

INSTANTIATE_TEST_SUITE_P(Each, McapFiles, ::testing::Values("none", "lz4", "zstd", "loose"),
                         [](const auto& test) { return std::string(test.param); });

class McapCompression : public ::testing::TestWithParam<Compression> {
 protected:
  /// Writes messages of 20 channels, 100 bytes to 3 kB each, in many chunks.
  void write_messages(Writer& writer) {
    for (int i = 0; i < 20; ++i) writer.add_channel(0, "/" + std::to_string(i), "", {});
    for (std::uint32_t i = 0; i < 300; ++i) {
      std::string data(100 + i * 10, static_cast<char>(i * 7));
      for (std::size_t at = 0; at < data.size(); at += 3) data[at] = static_cast<char>(at * i);
      written_.push_back({static_cast<std::uint16_t>(i % 20), i, i * std::uint64_t{1000}, i, data});
      const auto& kept = written_.back();
      writer.add({kept.channel, kept.sequence, kept.log_time, kept.publish_time, kept.data});
      writer.flush(false);
    }
  }
  Writer::Options options() const { return {.compression = GetParam(), .chunk_bytes = 20'000}; }

  const TemporaryFolder folder_;
  const std::string file_ = folder_ / "a.mcap";
  std::vector<Kept> written_;
};

TEST_P(McapCompression, GivesBackEachMessage) {
  Writer writer(file_, options());
  write_messages(writer);
  writer.close();
  Reader reader(file_);
  reader.check();
  EXPECT_TRUE(reader.whole()) << reader.problem();
  EXPECT_GT(reader.statistics().chunks, 10u);
  EXPECT_EQ(reader.statistics().messages, written_.size());
  EXPECT_EQ(all(reader), written_);
}

TEST_P(McapCompression, OfAFileThatLostItsEndGivesBackTheWholeChunks) {
  {
    Writer writer(file_, options());
    write_messages(writer);
  }  // as if the process had been killed
  const std::string bytes = bytes_of(file_);
  std::size_t most = 0;
  for (std::size_t size = 60; size <= bytes.size(); size += 7919) {
    write(file_ + ".cut", bytes.substr(0, size));
    Reader reader(file_ + ".cut");
    EXPECT_FALSE(reader.whole());
    EXPECT_THAT(reader.problem(), HasSubstr("has no end"));
    const auto read = all(reader);
    ASSERT_LE(read.size(), written_.size());
    EXPECT_TRUE(std::equal(read.begin(), read.end(), written_.begin()));
    EXPECT_GE(read.size(), most);
    most = read.size();
  }
  EXPECT_GT(most, written_.size() - 60);  // all but the last chunk
}

INSTANTIATE_TEST_SUITE_P(Each, McapCompression,
                         ::testing::Values(Compression::none, Compression::lz4, Compression::zstd),
                         [](const auto& test) {
                           const std::string word = word_of(test.param);
                           return word.empty() ? "none" : word;
                         });

TEST(McapReader, NoticesEachDamagedByte) {
  const TemporaryFolder folder;
  const std::string good = by_hand();
  const std::string file = folder / "a.mcap";
  for (std::size_t i = 0; i < good.size(); ++i) {
    std::string bad = good;
    bad[i] = static_cast<char>(bad[i] ^ 0x10);
    write(file, bad);
    bool noticed = false;
    try {
      Reader reader(file);
      reader.check();
      noticed = !reader.whole();
    } catch (const RecordingError&) {
      noticed = true;
    }
    EXPECT_TRUE(noticed) << "byte " << i << " of " << good.size();
  }
}

TEST(McapReader, ReadsAllRecordsWhenTheSummaryIsDamaged) {
  const TemporaryFolder folder;
  std::string bytes = by_hand();
  bytes[bytes.size() - 100] = static_cast<char>(bytes[bytes.size() - 100] ^ 1);
  write(folder / "a.mcap", bytes);
  Reader reader(folder / "a.mcap");
  EXPECT_THAT(reader.problem(), HasSubstr("its summary is damaged: the checksum is wrong; all records were read"));
  EXPECT_EQ(all(reader).size(), 2u);
}

/// A file with one chunk that says of itself what the test says.
std::string file_with_chunk(std::uint64_t uncompressed, const std::string& compression, const std::string& records) {
  const std::string head = "\x89MCAP0\r\n" + record(0x01, text("") + text(""));
  return head + record(0x06, little(0, 8) + little(0, 8) + little(uncompressed, 8) + little(0, 4) + text(compression) +
                                 little(records.size(), 8) + records);
}

TEST(McapReader, TakesNoMemoryForWhatAFileOnlySays) {
  const TemporaryFolder folder;
  const std::string file = folder / "a.mcap";
  for (const auto& [compression, bytes] :
       {std::pair<std::string, std::string>{"zstd", compress(Compression::zstd, std::string(1000, 'x'))},
        {"lz4", compress(Compression::lz4, std::string(1000, 'x'))},
        {"", "abc"},
        {"brotli", "abc"}}) {
    for (const std::uint64_t size : {std::uint64_t{1} << 60, std::uint64_t{200} << 20, std::uint64_t{10}}) {
      write(file, file_with_chunk(size, compression, bytes));
      Reader reader(file);
      EXPECT_THAT(reader.problem(), HasSubstr("a chunk is left out"));
      EXPECT_EQ(all(reader).size(), 0u);
    }
  }
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  constexpr long most_kilobytes = 1 << 20;
  EXPECT_LT(usage.ru_maxrss, most_kilobytes);
}

TEST(McapReader, CountsNoMessageOfAChunkThatItLeavesOut) {
  const TemporaryFolder folder;
  const std::string message = record(0x05, little(1, 2) + std::string(20, '\0'));
  const std::string records = message + "\x05 cut off";
  write(folder / "a.mcap", file_with_chunk(records.size(), "", records));
  Reader reader(folder / "a.mcap");
  EXPECT_THAT(reader.problem(), HasSubstr("a chunk ends within a record"));
  EXPECT_EQ(reader.statistics().messages, 0u);
}

TEST(McapReader, SaysWhatIsNoRecording) {
  const TemporaryFolder folder;
  const auto refusal = [&](const std::string& bytes, Limits limits = {}) -> std::string {
    write(folder / "a.mcap", bytes);
    try {
      Reader reader(folder / "a.mcap", limits);
      while (reader.next()) {
      }
    } catch (const RecordingError& error) {
      return error.what();
    }
    return "nothing was refused";
  };
  EXPECT_THAT(refusal("#!/bin/sh\n"), HasSubstr("is no MCAP file: it does not begin as one"));
  EXPECT_THAT(refusal("\x89MCAP0\r\n"), HasSubstr("nothing was recorded"));
  EXPECT_THAT(refusal(file_with_chunk(31, "", record(0x05, little(9, 2) + std::string(20, '\0')))),
              HasSubstr("a message of the channel 9, which nothing describes"));
  EXPECT_THAT(refusal(by_hand(), {.descriptions = 20}), HasSubstr("a record is too long"));
  EXPECT_THAT(refusal(by_hand(), {.chunk = 20}), HasSubstr("is too long"));
  EXPECT_THAT(refusal(by_hand(), {.open_chunks = 20}), HasSubstr("the times of too many chunks overlap"));
  EXPECT_THROW(Reader(folder / "none.mcap"), RecordingError);
  EXPECT_THROW(Reader(folder.path()), RecordingError);
}

TEST(McapWriter, KeepsTheFileThatIsThere) {
  const TemporaryFolder folder;
  write(folder / "a.mcap", "mine");
  EXPECT_THROW(Writer(folder / "a.mcap", {}), RecordingError);
  EXPECT_EQ(bytes_of(folder / "a.mcap"), "mine");
}

TEST(McapWriter, OnAFullDiskLeavesWhatWasWrittenReadable) {
  const TemporaryFolder folder;
  const std::string file = folder / "a.mcap";
  signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  {
    Writer writer(file, {.compression = Compression::none, .chunk_bytes = 1000});
    writer.add_channel(0, "/a", "", {});
    const rlimit small{10'000, before.rlim_max};
    setrlimit(RLIMIT_FSIZE, &small);
    const std::string data(300, 'x');
    const auto fill = [&] {
      for (std::uint32_t i = 0; i < 100; ++i) {
        writer.add({0, i, i, i, data});
        writer.flush(false);
      }
    };
    EXPECT_THROW(fill(), RecordingError);
    setrlimit(RLIMIT_FSIZE, &before);
  }
  Reader reader(file);
  EXPECT_GT(all(reader).size(), 20u);
  EXPECT_THAT(reader.problem(), ::testing::Not(HasSubstr("unfinished")));
}

TEST(McapWriter, LeavesNoOtherFile) {
  const TemporaryFolder folder;
  Writer writer(folder / "a.mcap", {});
  write_by_hand_with(writer);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1);
  writer.close();
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1);
}

}  // namespace
}  // namespace iotcloud::recording::mcap
