#include "iotcloud/tests/fuzz/seeds.h"

#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

#include <amqp.h>
#include <amqp_framing.h>
#include <stdlib.h>

#include "iotcloud/brokers/activemq/wire/statistics.h"
#include "iotcloud/brokers/activemq/wire/wire_message.h"
#include "iotcloud/brokers/envelope.h"
#include "iotcloud/brokers/rabbitmq/wire/headers.h"
#include "iotcloud/brokers/spool/store/bytes.h"
#include "iotcloud/brokers/spool/store/record.h"
#include "iotcloud/discovery/freeze.h"
#include "iotcloud/discovery/presence.h"
#include "iotcloud/discovery/records.h"
#include "iotcloud/discovery/submissions.h"
#include "iotcloud/drivers/depth/depth_codec.h"
#include "iotcloud/drivers/stream/framing.h"
#include "iotcloud/drivers/turtle/robot/protocol.h"
#include "iotcloud/master/orders/backup_file.h"
#include "iotcloud/recording/recording.h"

namespace iotcloud::fuzz {

namespace {

namespace depth = drivers::depth;

brokers::Message sample(int number) {
  brokers::Message message;
  message.payload = brokers::Payload::copy("reading " + std::to_string(number));
  message.driver_id = "0a1b2c";
  message.gateway_id = "gateway-1";
  message.time_ms = 1'700'000'000'000 + number;
  for (int i = 0; i < number; ++i) message.properties.set("property" + std::to_string(i), "value");
  return message;
}

std::string record(std::uint64_t sequence) {
  const brokers::Message message = sample(static_cast<int>(sequence));
  std::string bytes;
  brokers::spool::encode_head(sequence, message.time_ms, message, bytes);
  return bytes + std::string(message.payload.text());
}

std::string file_start() {
  std::string start = "IOTSPOOL";
  brokers::spool::put_number(start, std::uint32_t{1});
  brokers::spool::put_number(start, brokers::spool::checksum(std::as_bytes(std::span(start))));
  return start;
}

std::string mark(std::uint64_t value) {
  std::string bytes;
  brokers::spool::put_number(bytes, value);
  brokers::spool::put_number(bytes, brokers::spool::checksum(std::as_bytes(std::span(bytes))));
  return bytes;
}

/// A slope with gaps and a few rough lines; `step` is how much the pixels of these differ.
std::string depth_frame(depth::Codec codec, int step) {
  std::vector<std::uint16_t> frame(depth::frame_pixels);
  for (std::size_t i = 0; i < frame.size(); ++i) {
    const std::size_t u = i % depth::frame_width, v = i / depth::frame_width;
    const bool gap = step > 0 && u % 97 < 3;
    frame[i] =
        gap ? depth::no_reading : static_cast<std::uint16_t>(600 + v / 4 + (v % 160 < 2 ? u * v / 64 % 3 * step : 0));
  }
  depth::DepthEncoder encoder(codec);
  const auto payload = encoder.encode(depth::FrameView(frame));
  return {reinterpret_cast<const char*>(payload.data()), payload.size()};
}

std::string part(const std::string& bytes) {
  std::string all;
  brokers::spool::put_number(all, static_cast<std::uint16_t>(bytes.size()));
  return all + bytes;
}

std::string amqp_properties(int number) {
  const brokers::Message message = sample(number);
  brokers::rabbitmq::MessageProperties encoder;
  brokers::rabbitmq::MessageProperties::SendOptions delivery;
  delivery.resent = number % 2 == 1;
  delivery.expires_in = std::chrono::milliseconds(number);
  amqp_basic_properties_t properties = encoder.encode(message, delivery);
  std::string bytes(4096, '\0');
  const int size = amqp_encode_properties(AMQP_BASIC_CLASS, &properties, {bytes.size(), bytes.data()});
  bytes.resize(static_cast<std::size_t>(size));
  return bytes;
}

std::string envelope(int number) {
  const brokers::EnvelopeBytes bytes = brokers::encode_envelope(sample(number));
  return {reinterpret_cast<const char*>(bytes.data.get()), bytes.size};
}

std::string activemq_message(int number) {
  const brokers::Message message = sample(number);
  std::string bytes;
  brokers::activemq::write_head(message, {.to = "queue://q", .resent = number % 2 == 1}, bytes);
  return bytes + std::string(message.payload.text());
}

/// Headers that are tables within tables.
std::string nested_tables(int depth) {
  std::string table = "\1tV";  // an entry "t" without a value
  for (int i = 0; i < depth; ++i) {
    std::string length;
    for (int shift = 24; shift >= 0; shift -= 8) length.push_back(static_cast<char>(table.size() >> shift));
    table.insert(0, length).insert(0, i + 1 < depth ? "\1tF" : "");
  }
  return std::string("\x20\0", 2) + table;  // the flag of headers
}

/// Records of the registry, each after the number by which registry_records_fuzzer.cc chooses its kind.
SeedsOfTarget registry_records() {
  discovery::OrderRecord order;
  order.instance = discovery::InstanceId("01");
  order.plugin = "turtle.so";
  order.properties = {{"rate", "30"}};
  order.epoch = 7;
  order.previous = discovery::PluginVersion{"turtle.so", ""};
  discovery::TopologyOrder topology_order;
  topology_order.revision = 3;
  topology_order.parallelism = {{"decode", 2}};
  topology_order.kill = {{"w"}, 500, 1};
  discovery::TopologyRecord topology;
  topology.name = discovery::TopologyName("t");
  topology.spouts = {"s"};
  discovery::WorkerRecord worker;
  worker.name = "w";
  worker.components = {{"decode", {2, 4}}};
  discovery::ChannelRecord channel;
  channel.name = "data";
  channel.properties = {{"queueName", "q"}};
  discovery::DriverRecord driver;
  driver.name = discovery::DriverName("turtle");
  driver.metadata = {{"room", "7"}};
  driver.channels = {channel};
  discovery::GatewayRecord gateway;
  gateway.id = discovery::GatewayId("gw");
  gateway.brokers = {"rabbitmq"};
  discovery::Submission submission;
  submission.name = topology.name;
  submission.version = {2, "yaml", {{"x.so", "x.so", "12"}}, "digest"};
  submission.previous = {1, "before", {}, ""};
  discovery::PoolRecord pool;
  pool.id = discovery::PoolId("p");
  pool.host = "lab1";
  pool.places = {{topology.name, 1, {}, 2, "running", "", "w", 5}};
  const std::string deep = std::string(70, '[') + std::string(70, ']');
  return {
      {"order", '\0' + encode(order)},
      {"deep", std::string(1, '\0') + R"({"instance":"1","plugin":"p","new":)" + deep + "}"},
      {"drain", '\1' + encode(discovery::DrainRecord{5, 7})},
      {"topology", '\2' + encode(topology)},
      {"topology_order", '\3' + encode(topology_order)},
      {"worker", '\4' + encode(worker)},
      {"life", '\5' + encode(discovery::GatewayLife{"lab1", 12905, 7, "state", "run"})},
      {"reader", '\6' + encode(discovery::ReaderRecord{topology.name, 3, true, "rabbitmq", "x == 1", 5,
                                                       "side x 1; up x 4", "storm"})},
      {"driver", '\7' + encode(driver)},
      {"channel", '\x08' + encode(channel)},
      {"freeze", '\x09' + encode(discovery::FreezeRecord{"emptied", 5, "token", true})},
      {"adoption", '\x0a' + encode(discovery::Adoption{"token", 7})},
      {"gateway", '\x0b' + encode(gateway)},
      {"submission", '\x0c' + encode(submission)},
      {"pool", '\x0d' + encode(pool)},
      {"history", '\x0e' + encode(discovery::TopologyHistory{{{5, "submit", 1, "digest", 2, "1 of 1 done"}}})},
      {"removal", '\x0f' + encode(discovery::OrderRemoval{order.instance, 7, 1'700'000'000'000})},
  };
}

/// What plugins say of themselves, in their bytes and as a gateway tells it.
SeedsOfTarget declarations() {
  const std::string card = R"(iotcloud-plugin: driver={"name":"meter","version":"2"})" + std::string(1, '\0');
  const std::string properties =
      R"({"description":"Reads a meter.","properties":[)"
      R"({"name":"rate","type":"number","unit":"Hz","min":0.1,"max":1000,"default":"30","text":"how often"},)"
      R"({"name":"mode","type":"text","choices":["a","b"],"required":true},{"name":"n","type":"integer"}]})";
  const std::string declared = "iotcloud-plugin: declaration=" + properties + std::string(1, '\0');
  return {{"bytes",
           "\x7f"
           "ELF" +
               card + "iotcloud-plugin: driver-sdk=5;" + declared},
          {"twice", "iotcloud-plugin: driver={" + card + declared + declared},
          {"deep", "iotcloud-plugin: declaration={\"properties\":" + std::string(500, '[') + std::string(1, '\0')},
          {"json", R"({"driver":"meter","version":"2","sdk_version":5,)" + properties.substr(1)}};
}

/// Recordings for recording_fuzzer.cc.
SeedsOfTarget recordings() {
  const std::string frame = "P5 640 480 65535\n\1\2";
  return {{"two", part("d-1.000000-7.pgm\nr-1.0-7.ppm\nd-1.033333-9.pgm\r\n") + frame},
          {"back", part("d-9.5-1.pgm\nd-2.5-2.pgm\na-2.6-3.dump\n") + frame.substr(0, 10)},
          {"far", part("d-0-1.pgm\nd-1e300-2.pgm\n") + frame},
          {"none", part("r-1.0-7.ppm\n")}};
}

/// Recordings for mcap_fuzzer.cc: with and without an end, of each compression.
SeedsOfTarget mcap_files() {
  namespace mcap = recording::mcap;
  SeedsOfTarget seeds;
  for (const auto compression : {mcap::Compression::none, mcap::Compression::lz4, mcap::Compression::zstd}) {
    for (const bool whole : {true, false}) {
      std::string folder = std::filesystem::temp_directory_path() / "mcap-seeds-XXXXXX";
      if (mkdtemp(folder.data()) == nullptr) throw std::runtime_error("no folder for a recording");
      const std::string file = folder + "/a.mcap";
      {
        recording::RecordingWriter writer(file, {.compression = compression, .chunk_bytes = 100});
        const auto out = writer.add_channel({"meter", "1", "meter/1", "lab", "reading", true, false, {{"a", "b"}}});
        const auto shared = writer.add_channel({"meter", "", "", "lab", "status", true, true});
        for (int i = 0; i < 4; ++i) {
          brokers::Message message;
          message.payload = brokers::Payload::copy("{\"value\": 1}");
          message.driver_id = std::to_string(i % 2);
          message.time_ms = i - 1;
          if (i == 2) message.properties.set("unit", "C");
          writer.add(i == 3 ? shared : out, message, recording::Instant(i * 1000));
        }
        whole ? writer.close() : writer.flush();
      }
      std::ifstream in(file, std::ios::binary);
      seeds[std::string(compression == mcap::Compression::none ? "none" : mcap::word_of(compression)) +
            (whole ? "" : "_cut")] = std::string(std::istreambuf_iterator<char>(in), {});
      std::filesystem::remove_all(folder);
    }
  }
  return seeds;
}

/// A backup with all that one can have.
std::string whole_backup() {
  discovery::OrderRecord order;
  order.instance = discovery::InstanceId("01");
  order.plugin = "turtle.so";
  order.sha256 = std::string(64, 'a');
  order.properties = {{"rate", "30"}};
  order.epoch = 7;
  discovery::TopologyOrder topology;
  topology.revision = 3;
  topology.parallelism = {{"decode", 2}};
  master::Backup backup;
  backup.made_ms = 1'700'000'000'000;
  backup.gateways = {{discovery::GatewayId("lab1"), true, {order, order}}, {discovery::GatewayId("lab2"), false, {}}};
  backup.topologies = {{discovery::TopologyName("t"), topology}};
  backup.missing_plugins = master::sent_plugins(backup.gateways);
  return master::encode(backup);
}

/// Definitions of types of ROS, and a message of each.
SeedsOfTarget ros_messages() {
  const std::string next = std::string(80, '=') + "\nMSG: ";
  const std::string stamped =
      "Header header\nVector3[] all # of them\nint8 X=1\nstring[2] names\nuint8[] data\nbool is\nfloat32 y\n" + next +
      "std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n" + next + "a/Vector3\nfloat64 x\nduration d\n";
  const std::string zero(1, '\0'), zeros(3, '\0');
  const std::string message = std::string(12, '\x01') + "\x01" + zeros + "f" + "\x01" + zeros +
                              std::string(16, '\x3f') + "\x02" + zeros + "ab" + zeros + zero + "\x03" + zeros + "xyz" +
                              "\x01" + std::string(4, '\x3f');
  return {{"stamped", stamped + zero + message},
          {"json", stamped + zero +
                       R"({"header":{"seq":7},"all":[{"x":0.5,"d":{"secs":1,"nsecs":2}}],"data":"AQID","is":true})"},
          {"itself", "B b\n" + zero}};
}

/// Streams of a device, after the byte that says how it frames them and the one that cuts them into pieces.
SeedsOfTarget framings() {
  SeedsOfTarget seeds;
  for (const auto& [name, kind] : {std::pair{"delimiter", drivers::stream::Framing::delimiter},
                                   {"length", drivers::stream::Framing::length},
                                   {"cobs", drivers::stream::Framing::cobs},
                                   {"slip", drivers::stream::Framing::slip}}) {
    drivers::stream::FramingOptions options;
    options.kind = kind;
    options.length_bytes = 1;
    std::string stream{static_cast<char>(kind), '\4'};
    for (const std::string& frame :
         {std::string("12.5 kg"), std::string("a\0\xc0\xdb", 4), std::string(45, 'x'), std::string("")})
      stream += drivers::stream::framed(options, std::as_bytes(std::span(frame)));
    seeds[name] = stream;
  }
  return seeds;
}

}  // namespace

Seeds all_seeds() {
  Seeds seeds;
  for (int i = 0; i < 4; ++i) {
    const std::string name = std::to_string(i);
    seeds["spool_record"][name] = record(static_cast<std::uint64_t>(i));
    seeds["spool_record"]["body" + name] = record(static_cast<std::uint64_t>(i)).substr(12);
    seeds["amqp_headers"][name] = amqp_properties(i);
    seeds["activemq_message"][name] = activemq_message(i);
    seeds["envelope"][name] = envelope(i);
    seeds["amqp_headers"]["nested" + name] = nested_tables(i * 5 + 1);
  }
  seeds["activemq_message"]["question"] = brokers::activemq::statistics_question("queue", "answers", 7);
  const std::string first = file_start() + record(1) + record(2);
  const std::string second = file_start() + record(3) + record(4);
  seeds["selection"]["issue"] = R"(site == "lab" and battery > 20 and within(location, 39.17, -86.52, 500 m))";
  seeds["selection"]["words"] =
      R"(not (a in [1, 'b', true] or a not in [-2.5e3]) and exists(`any key`) or starts_with(b, "\"x"))";
  seeds["selection"]["plane"] = "within(position, 3, -4.5, 2 km) and ends_with(x,'1')\nor contains(y, '')";
  seeds["spool_folder"]["good"] = part(mark(2)) + part(first) + second;
  seeds["spool_folder"]["torn"] = part("") + part(first) + second.substr(0, second.size() - 5);
  seeds["spool_folder"]["gap"] = part(mark(1)) + part(file_start() + record(2)) + file_start() + record(4);
  // Without tables, and with states that no encoder wrote: the decoder refuses these and their prefixes early.
  seeds["depth_frame"]["states_compact"] = std::string(60, '\0');
  seeds["depth_frame"]["states_lossless"] = '\1' + std::string(60, '\0');
  for (const depth::Codec codec : {depth::Codec::reference, depth::Codec::compact, depth::Codec::lossless}) {
    for (const int step : {0, 1, 40}) {
      const std::string frame = depth_frame(codec, step);
      const std::string name = std::string(depth::codec_names[static_cast<int>(codec)]) + std::to_string(step);
      seeds["depth_frame"][name] = frame;
      // The codec's number and the body: the fuzzer prepends a valid checksum.
      if (codec != depth::Codec::reference) {
        const char number = codec == depth::Codec::compact ? 0 : 1;
        seeds["depth_frame"]["body_" + name] = number + frame.substr(8);
      }
    }
  }
  namespace robot = drivers::turtle::robot;
  robot::FrameHead head{
      .number = 3, .age_us = 500, .device_time_s = 1.5, .repeated = true, .lock_step = true, .truth = {}};
  const std::string plain = robot::write_frame_head(head, 5) + "frame";
  head.truth = drivers::turtle::GroundTruth{.robot_x = 1, .distance = 0.7, .visible = true};
  const std::string of_agent = robot::write_hello({.silence_ms = 250, .nonce = {}, .name = "laptop"}) +
                               robot::write_proof({}) + plain + robot::write_frame_head(head, 5) + "frame" +
                               robot::write_bare(robot::Kind::alive);
  const std::string of_driver = robot::write_challenge({.silence_ms = 250, .nonce = {}, .proof = {}}) +
                                robot::write_bare(robot::Kind::start) +
                                robot::write_drive({.linear = 0.2, .angular = -1}) +
                                robot::write_number(robot::Kind::got, 3) + robot::write_refused("no");
  seeds["robot_protocol"]["agent"] = '\x06' + of_agent;
  seeds["robot_protocol"]["driver"] = '\x13' + of_driver;
  seeds["framing"] = framings();
  seeds["ros_message"] = ros_messages();
  seeds["registry_records"] = registry_records();
  seeds["declaration"] = declarations();
  seeds["recording"] = recordings();
  seeds["mcap"] = mcap_files();
  seeds["backup"] = {{"whole", whole_backup()}, {"empty", R"({"format":1})"}, {"later", R"({"format":2})"}};
  add_control_plane_seeds(seeds);
  add_wire_seeds(seeds);
  add_device_seeds(seeds);
  return seeds;
}

}  // namespace iotcloud::fuzz
