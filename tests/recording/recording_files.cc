// Writes a recording, or reads one, and prints its messages as JSON: for mcap_peer_test.py and recording_test.py.
//   recording_files write none|lz4|zstd FILE    recording_files read FILE    recording_files messages UNFINISHED_FILE
#include <cstdio>
#include <cstring>
#include <exception>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/recording/recording.h>

namespace {

using namespace iotcloud::recording;

nlohmann::json words(const std::string& topic, const mcap::Message& message) {
  std::string hex;
  for (const char c : message.data) hex += fmt::format("{:02x}", static_cast<unsigned char>(c));
  return {topic, message.sequence, message.log_time, message.publish_time, hex};
}

nlohmann::json write(const std::string& compression, const std::string& file) {
  nlohmann::json messages = nlohmann::json::array();
  mcap::Writer writer(file, {.profile = "test",
                             .compression = mcap::compression_of(compression == "none" ? "" : compression),
                             .chunk_bytes = 2000});
  const auto schema = writer.add_schema("Reading", "jsonschema", "{}");
  const auto readings = writer.add_channel(schema, "/readings", "json", {{"place", "roof"}});
  const auto raw = writer.add_channel(0, "/raw", "", {});
  for (std::uint32_t i = 0; i < 500; ++i) {
    const std::string data = i % 2 == 0 ? fmt::format("{{\"value\":{}}}", i) : std::string(i, static_cast<char>(i));
    const mcap::Message message{i % 2 == 0 ? readings : raw, i, std::uint64_t{1'700'000'000'000'000'000} + i, i, data};
    writer.add(message);
    writer.flush(false);
    messages.push_back(words(i % 2 == 0 ? "/readings" : "/raw", message));
  }
  writer.add(mcap::Metadata{"site", {{"city", "Bloomington"}}});
  writer.close();
  return {{"messages", messages}};
}

/// \param strict refuses a file that has no end, or anything damaged.
nlohmann::json read(const std::string& file, bool strict) {
  nlohmann::json messages = nlohmann::json::array();
  mcap::Reader reader(file);
  if (strict) reader.check();
  if (strict && !reader.whole()) throw RecordingError(reader.problem());
  while (const auto message = reader.next())
    messages.push_back(words(reader.channels().at(message->channel).topic, *message));
  return messages;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    if (argc == 4 && std::strcmp(argv[1], "write") == 0) {
      std::puts(write(argv[2], argv[3]).dump().c_str());
    } else if (argc == 3 && std::strcmp(argv[1], "read") == 0) {
      std::puts(read(argv[2], true).dump().c_str());
    } else if (argc == 3 && std::strcmp(argv[1], "messages") == 0) {
      std::puts(read(argv[2], false).dump().c_str());
    } else {
      return 2;
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
