#include <stdexcept>
#include <utility>

#include <iotcloud/drivers/stream/stream_driver.h>

namespace iotcloud::drivers::stream {

std::vector<ChannelSpec> StreamDriver::channels(const PropertyMap& properties) {
  PropertyReader reader(properties);
  framing_ = read_framing(reader);
  broker_ = reader.text("broker", "");
  read(reader);
  ChannelSpec received;
  received.name = received_channel;
  received.broker = broker_;
  ChannelSpec commands = received;
  commands.name = send_channel;
  commands.direction = Direction::in;
  return {received, commands};
}

void StreamDriver::open(DriverContext& context) {
  context_ = &context;
  lost_.emplace(context);
  state_.emplace(context);
  connect();
}

bool StreamDriver::publish(const Payload& frame, std::string_view peer) {
  if (!active_) return true;
  if (blocked_) return false;
  Message message;
  message.payload = frame;
  if (!peer.empty()) message.properties.set(peer_property, peer);
  blocked_ = context_->publish(received_channel, std::move(message)) == PublishStatus::would_block;
  return !blocked_;
}

void StreamDriver::on_writable(std::string_view channel) {
  if (channel != received_channel) return;
  blocked_ = false;
  resume();
}

void StreamDriver::on_message(std::string_view channel, Message message) {
  if (channel != send_channel) return;
  std::string bytes, problem;
  try {
    bytes = framed(framing_, message.payload.bytes());
    problem = send(bytes, message);
  } catch (const FramingError& e) {
    problem = e.what();
  }
  if (!problem.empty()) lose("a command of " + std::to_string(message.payload.size()) + " bytes", problem);
}

void StreamDriver::lose(const std::string& what, const std::string& why) {
  lost_->warn(what + " is lost: " + why);
}

void ConnectingDriver::read(PropertyReader& reader) {
  constexpr int longest_wait = 600'000;
  options_.framing = framing();
  options_.frame_limit = std::chrono::milliseconds(reader.integer("frame_limit_ms", 0, 0, longest_wait));
  options_.most_unsent = static_cast<std::size_t>(reader.integer("unsent_bytes", 1 << 20, 1, 64 << 20));
  keeps_ = reader.choice("while_away", "drop", {"drop", "keep"}) == "keep";
  pauses_ = ReconnectPauses::read(reader);
}

void ConnectingDriver::open(DriverContext& context) {
  retry_.emplace(context, pauses_);
  StreamDriver::open(context);
}

void ConnectingDriver::close() {
  link_.reset();
  retry_.reset();
}

void ConnectingDriver::connected(int input, int output, const PropertyMap& metadata) {
  retry_->reached();
  link_ = std::make_unique<FrameLink>(context(), input, output, options_,
                                      FrameLink::Handlers{[this](const Payload& frame) { return publish(frame); },
                                                          [this](const std::string& reason) {
                                                            link_.reset();
                                                            ended(reason);
                                                          }});
  tell_connected(metadata);
  waiting_bytes_ = 0;
  for (const std::string& bytes : std::exchange(waiting_, {})) {
    if (!link_->send(bytes)) lose("a command that waited", "the device takes commands too slowly");
  }
}

void ConnectingDriver::away(const std::string& reason) {
  tell_away(reason);
  retry_->later([this] { connect(); });
}

std::string ConnectingDriver::send(const std::string& bytes, const Message& /*message*/) {
  if (link_) return link_->send(bytes) ? "" : "the device takes commands too slowly (unsent_bytes), or none any more";
  if (!keeps_) return "the device is away (while_away is drop)";
  if (waiting_bytes_ + bytes.size() > options_.most_unsent) return "the device is away, and others wait (unsent_bytes)";
  waiting_.push_back(bytes);
  waiting_bytes_ += bytes.size();
  return "";
}

void ConnectingDriver::resume() {
  if (link_) link_->resume();
}

}  // namespace iotcloud::drivers::stream
