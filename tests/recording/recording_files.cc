// Writes a recording, or reads one, and prints its messages as JSON: for mcap_peer_test.py and recording_test.py.
//   recording_files write none|lz4|zstd FILE    recording_files read FILE    recording_files messages UNFINISHED_FILE
//   recording_files compare FILE PLAYED SPEED   says what differs between a recording and one of its play
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

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

using Channels = std::map<std::string, std::vector<RecordedMessage>>;

/// The messages of each channel, in their order. One that a broker handed over again counts once.
/// \param twice is raised by the number of these
Channels channels_of(const std::string& file, std::size_t& twice) {
  RecordingReader reader(file);
  reader.check();
  Channels channels;
  std::map<std::string, std::set<std::string>> seen;
  while (auto message = reader.next()) {
    const auto& channel = reader.channels().at(message->channel);
    const std::string name = channel.instance + ' ' + channel.name;
    if (seen[name].emplace(message->message.payload.text()).second) {
      channels[name].push_back(std::move(*message));
    } else {
      ++twice;
    }
  }
  return channels;
}

/// How many messages and channels there are in both; which of the recording's messages the play has not, or not at
/// their place or with other bytes, properties or times; and by how much the spacing of arrivals, times the speed, is
/// another one than the recorded one, in milliseconds: for each message, from the first of its file.
nlohmann::json compare(const std::string& file, const std::string& played, double speed) {
  std::size_t twice = 0;
  const Channels was = channels_of(file, twice), is = channels_of(played, twice);
  const auto begin = [](const Channels& channels) {
    Instant first = Instant::max();
    for (const auto& [name, messages] : channels) first = std::min(first, messages.front().at);
    return first;
  };
  const Instant was_begun = begin(was), is_begun = begin(is);
  nlohmann::json different = nlohmann::json::array();
  std::vector<double> off_ms;
  std::size_t bytes = 0;
  for (const auto& [name, messages] : was) {
    const auto found = is.find(name);
    const std::size_t there = found == is.end() ? 0 : found->second.size();
    if (there != messages.size()) different.push_back({name, messages.size(), there});
    for (std::size_t i = 0; i < std::min(there, messages.size()); ++i) {
      const RecordedMessage &a = messages[i], &b = found->second[i];
      if (a.message.payload != b.message.payload || a.message.properties != b.message.properties ||
          a.message.time_ms != b.message.time_ms)
        different.push_back({name, i});
      bytes += a.message.payload.size();
      const double expected = static_cast<double>((a.at - was_begun).count());
      off_ms.push_back(std::abs(static_cast<double>((b.at - is_begun).count()) * speed - expected) / 1e6);
    }
  }
  for (const auto& [name, messages] : is) {
    if (!was.contains(name)) different.push_back({name, 0, messages.size()});
  }
  std::sort(off_ms.begin(), off_ms.end());
  const auto quantile = [&](double share) {
    return off_ms.empty() ? 0 : off_ms[static_cast<std::size_t>(share * static_cast<double>(off_ms.size() - 1))];
  };
  return {{"channels", was.size()},
          {"messages", off_ms.size()},
          {"bytes", bytes},
          {"twice", twice},
          {"different", different},
          {"off_p50_ms", quantile(0.5)},
          {"off_p99_ms", quantile(0.99)},
          {"off_max_ms", quantile(1)}};
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
    } else if (argc == 5 && std::strcmp(argv[1], "compare") == 0) {
      std::puts(compare(argv[2], argv[3], std::atof(argv[4])).dump().c_str());
    } else {
      return 2;
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
