#include <algorithm>
#include <charconv>
#include <limits>

#include <iotcloud/brokers/limits.h>
#include <iotcloud/recording/recording.h>

namespace iotcloud::recording {

namespace {

constexpr std::uint64_t ns_in_ms = 1'000'000;
constexpr const char* profile = "iotcloud";
constexpr const char* properties_encoding = "iotcloud.properties";
/// No message has a property of this name (docs/wire.md#message-metadata), so it holds a time that MCAP cannot.
constexpr const char* time_name = "time";
constexpr std::string_view instance_metadata = "metadata.";
/// Bytes of properties that wait for their messages: a writer of ours puts each right before its message.
constexpr std::size_t most_waiting = std::size_t{16} << 20;

/// Times that MCAP's unsigned nanoseconds hold.
bool is_exact(std::int64_t time_ms) {
  return time_ms >= 0 && static_cast<std::uint64_t>(time_ms) <= std::numeric_limits<std::uint64_t>::max() / ns_in_ms;
}

/// What other programs may take the payloads of a channel for, as its first one looks.
const char* encoding_of(std::string_view payload) {
  return payload.size() >= 2 && payload.front() == '{' && payload.back() == '}' ? "json" : "";
}

std::string topic_of(const RecordedChannel& channel, const brokers::Message& message) {
  std::string topic =
      "/" + channel.driver + "/" +
      (!channel.alias.empty() && channel.instance == message.driver_id ? channel.alias : message.driver_id);
  return topic + "/" + channel.name;
}

/// "/camera/image" as a channel's name.
std::string name_of_topic(std::string topic) {
  constexpr std::size_t longest = 200;
  topic.erase(0, topic.find_first_not_of('/'));
  for (char& c : topic) {
    if (c == '/' || static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = '.';
  }
  if (topic.size() > longest) topic.resize(longest);
  return topic.empty() ? "messages" : topic;
}

std::string text(const mcap::Map& map, std::string_view key) {
  return std::string(mcap::value_of(map, key));
}

}  // namespace

RecordingWriter::RecordingWriter(std::string path, Options options)
    : writer_(std::move(path),
              {.profile = profile, .compression = options.compression, .chunk_bytes = options.chunk_bytes}) {}

std::size_t RecordingWriter::add_channel(RecordedChannel channel) {
  channels_.push_back(std::move(channel));
  return channels_.size() - 1;
}

RecordingWriter::Stream& RecordingWriter::stream_of(std::size_t number, const brokers::Message& message) {
  const auto key = std::tuple(number, message.driver_id, message.gateway_id);
  if (const auto found = streams_.find(key); found != streams_.end()) return found->second;
  const RecordedChannel& channel = channels_.at(number);
  mcap::Map metadata{{"driver", channel.driver},
                     {"instance", channel.instance},
                     {"alias", channel.alias},
                     {"gateway", channel.gateway},
                     {"channel", channel.name},
                     {"direction", channel.out ? "out" : "in"},
                     {"shared", channel.shared ? "true" : "false"},
                     {"driver_id", message.driver_id},
                     {"gateway_id", message.gateway_id}};
  for (const auto& [name, value] : channel.metadata)
    metadata.emplace_back(std::string(instance_metadata) + name, value);
  Stream stream;
  stream.topic = topic_of(channel, message);
  // Two gateways may each have a meter/1.
  for (int i = 2; !topics_.insert(stream.topic).second; ++i)
    stream.topic = topic_of(channel, message) + "#" + std::to_string(i);
  stream.channel = writer_.add_channel(0, stream.topic, encoding_of(message.payload.text()), std::move(metadata));
  return streams_.emplace(key, std::move(stream)).first->second;
}

void RecordingWriter::add(std::size_t channel, const brokers::Message& message, Instant at) {
  Stream& stream = stream_of(channel, message);
  last_ = std::max(last_, static_cast<std::uint64_t>(std::max(at.count(), Instant::rep{0})));
  mcap::Message record;
  record.channel = stream.channel;
  record.sequence = stream.sequence++;
  record.log_time = last_;
  record.publish_time = is_exact(message.time_ms) ? static_cast<std::uint64_t>(message.time_ms) * ns_in_ms : 0;
  if (!message.properties.empty() || !is_exact(message.time_ms)) {
    if (!stream.properties) {
      stream.properties = writer_.add_channel(0, stream.topic + "/properties", properties_encoding,
                                              {{"properties_of", std::to_string(stream.channel)}});
    }
    mcap::Map map(message.properties.begin(), message.properties.end());
    if (!is_exact(message.time_ms)) map.emplace_back(time_name, std::to_string(message.time_ms));
    properties_bytes_.clear();
    mcap::append(properties_bytes_, map);
    mcap::Message beside = record;
    beside.channel = *stream.properties;
    beside.data = properties_bytes_;
    writer_.add(beside);
  }
  record.data = message.payload.text();
  writer_.add(record);
  ++messages_;
  writer_.flush(false);  // not between a message and its properties
}

RecordingReader::RecordingReader(std::string path, mcap::Limits limits) : reader_(std::move(path), limits) {
  read_channels();
}

Instant RecordingReader::instant_of(std::uint64_t nanoseconds) {
  constexpr auto last = static_cast<std::uint64_t>(std::numeric_limits<Instant::rep>::max());
  return Instant(static_cast<Instant::rep>(std::min(nanoseconds, last)));
}

void RecordingReader::read_channels() {
  std::unordered_map<std::uint16_t, std::uint64_t> counts;
  for (const auto& [id, count] : reader_.statistics().channel_messages) counts[id] = count;
  const bool ours = reader_.header().profile == profile;
  std::map<RecordedChannel, std::size_t> places;
  std::map<std::string, int> names;  // and the last number behind each
  for (const auto& [id, of_file] : reader_.channels()) {
    Source source;
    if (ours && of_file.message_encoding == properties_encoding) {
      const std::string_view of = mcap::value_of(of_file.metadata, "properties_of");
      std::uint16_t number = 0;
      const auto [end, error] = std::from_chars(of.data(), of.data() + of.size(), number);
      if (error != std::errc{} || end != of.data() + of.size())
        throw RecordingError("the channel " + of_file.topic + " does not say of which channel its properties are");
      source.properties_of = number;
      sources_.emplace(id, std::move(source));
      continue;
    }
    RecordedChannel channel;
    if (ours) {
      const auto& map = of_file.metadata;
      channel = {text(map, "driver"),          text(map, "instance"), text(map, "alias"),
                 text(map, "gateway"),         text(map, "channel"),  text(map, "direction") != "in",
                 text(map, "shared") == "true"};
      for (const auto& [key, value] : map) {
        if (key.starts_with(instance_metadata)) channel.metadata[key.substr(instance_metadata.size())] = value;
      }
      source.driver_id = text(map, "driver_id");
      source.gateway_id = text(map, "gateway_id");
      // On a shared channel each sender is an instance of its own.
      if (channel.shared) channel.instance = source.driver_id;
    } else {
      channel.driver = "recording";
      channel.name = name_of_topic(of_file.topic);
      const std::string base = channel.name;
      while (names.contains(channel.name)) channel.name = base + "." + std::to_string(++names[base]);
      names[channel.name] = 1;
    }
    const auto [place, fresh] = places.try_emplace(std::move(channel), channels_.size());
    source.channel = place->second;
    if (fresh) {
      channels_.push_back(place->first);
      counts_.push_back(0);
    }
    counts_[source.channel] += counts[id];
    sources_.emplace(id, std::move(source));
  }
}

void RecordingReader::keep_properties(const Source& source, const mcap::Message& record) {
  Waiting waiting{record.sequence, record.data.size()};
  const auto map = mcap::Content(record.data).map();
  if (map.size() > brokers::max_received_properties)
    throw RecordingError("a message of the recording has " + std::to_string(map.size()) + " properties");
  for (const auto& [name, value] : map) {
    if (name != time_name) {
      waiting.properties.set(name, value);
      continue;
    }
    std::int64_t time = 0;
    const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), time);
    if (error == std::errc{} && end == value.data() + value.size()) waiting.time_ms = time;
  }
  Waiting& place = waiting_[*source.properties_of];
  waiting_bytes_ += waiting.bytes - place.bytes;
  if (waiting_bytes_ > most_waiting)
    throw RecordingError("the recording has more than " + std::to_string(most_waiting >> 20) +
                         " MiB of properties without their messages");
  place = std::move(waiting);
}

std::optional<RecordedMessage> RecordingReader::next() {
  while (const auto record = reader_.next()) {
    const Source& source = sources_.at(record->channel);
    if (source.properties_of) {
      keep_properties(source, *record);
      continue;
    }
    RecordedMessage recorded;
    recorded.channel = source.channel;
    recorded.at = instant_of(record->log_time);
    recorded.message.driver_id = source.driver_id;
    recorded.message.gateway_id = source.gateway_id;
    recorded.message.time_ms = static_cast<std::int64_t>(record->publish_time / ns_in_ms);
    recorded.message.payload = brokers::Payload::copy(record->data);
    if (const auto found = waiting_.find(record->channel); found != waiting_.end()) {
      if (found->second.sequence == record->sequence) {
        recorded.message.properties = std::move(found->second.properties);
        if (found->second.time_ms) recorded.message.time_ms = *found->second.time_ms;
      }
      waiting_bytes_ -= found->second.bytes;
      waiting_.erase(found);
    }
    return recorded;
  }
  return std::nullopt;
}

void RecordingReader::rewind() {
  reader_.rewind();
  waiting_.clear();
  waiting_bytes_ = 0;
}

bool names_instance(const RecordedChannel& channel, std::string_view word) {
  constexpr std::size_t least = 4;
  return word == channel.instance || (!channel.alias.empty() && word == channel.alias) ||
         (word.size() >= least && channel.instance.starts_with(word));
}

}  // namespace iotcloud::recording
