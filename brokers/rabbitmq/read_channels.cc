#include "iotcloud/brokers/rabbitmq/read_channels.h"

#include <utility>

namespace iotcloud::brokers::rabbitmq {

std::optional<QueueReader*> ReadChannels::find(amqp_channel_t channel) const {
  const auto found = readers_.find(channel);
  if (found == readers_.end()) return std::nullopt;
  return found->second.get();
}

/// The library keeps about 18 KB for each number that was ever used.
amqp_channel_t ReadChannels::lowest_free() const {
  amqp_channel_t lowest = 1;
  for (const auto& [number, reader] : readers_) {
    if (number != lowest) break;
    ++lowest;
  }
  return lowest;
}

void ReadChannels::open(const std::shared_ptr<QueueReader>& reader) {
  reader->channel = lowest_free();
  readers_[reader->channel] = reader;
  outgoing_.push_back({Outgoing::Kind::request, reader->channel, reader->prefetch, false, reader});
}

void ReadChannels::limit(const QueueReader& reader) {
  outgoing_.push_back({Outgoing::Kind::limit, reader.channel, reader.prefetch, false, nullptr});
}

void ReadChannels::ask(const std::shared_ptr<QueueReader>& reader) {
  outgoing_.push_back({Outgoing::Kind::ask, reader->channel, 0, false, reader});
}

void ReadChannels::close(QueueReader& reader) {
  outgoing_.push_back({Outgoing::Kind::close, reader.channel, 0, false, nullptr});
  readers_[reader.channel] = nullptr;
  reader.forget_channel();
}

void ReadChannels::closed_by_server(amqp_channel_t channel) {
  std::erase_if(outgoing_, [&](const Outgoing& one) { return one.channel == channel; });
  outgoing_.push_back({Outgoing::Kind::close_ok, channel, 0, false, nullptr});
  readers_.erase(channel);
}

void ReadChannels::settle(QueueReader& reader, std::size_t patience) {
  using Kind = client::AckWindow::Kind;
  for (const client::AckWindow::Action& action : reader.window.take(patience)) {
    const auto kind = action.kind == Kind::acknowledge ? Outgoing::Kind::acknowledge : Outgoing::Kind::reject;
    outgoing_.push_back({kind, reader.channel, action.tag, action.multiple, nullptr});
  }
}

void ReadChannels::write(AmqpLink& wire) {
  auto next = outgoing_.begin();
  for (; next != outgoing_.end(); ++next) {
    if (!std::exchange(writable_, false) && !wire.room_for(0)) break;
    write_method(wire, *next);
  }
  outgoing_.erase(outgoing_.begin(), next);
}

void ReadChannels::write_all(AmqpLink& wire) {
  for (const Outgoing& what : outgoing_) write_method(wire, what);
  outgoing_.clear();
}

void ReadChannels::clear() {
  readers_.clear();
  outgoing_.clear();
  writable_ = false;
}

void ReadChannels::write_method(AmqpLink& wire, const Outgoing& what) const {
  switch (what.kind) {
    case Outgoing::Kind::request:
      return what.reader->request(wire, what.channel, static_cast<std::uint16_t>(what.tag));
    case Outgoing::Kind::limit:
      return QueueReader::limit_channel(wire, what.channel, static_cast<std::uint16_t>(what.tag));
    case Outgoing::Kind::ask:
      return what.reader->ask(wire, what.channel);
    case Outgoing::Kind::acknowledge: {
      amqp_basic_ack_t ack{};
      ack.delivery_tag = what.tag;
      ack.multiple = what.multiple ? 1 : 0;
      return wire.send(what.channel, AMQP_BASIC_ACK_METHOD, ack);
    }
    case Outgoing::Kind::reject: {
      amqp_basic_nack_t nack{};
      nack.delivery_tag = what.tag;
      nack.multiple = what.multiple ? 1 : 0;
      return wire.send(what.channel, AMQP_BASIC_NACK_METHOD, nack);
    }
    case Outgoing::Kind::close: {
      amqp_channel_close_t request{};
      request.reply_code = AMQP_REPLY_SUCCESS;
      return wire.send(what.channel, AMQP_CHANNEL_CLOSE_METHOD, request);
    }
    case Outgoing::Kind::close_ok:
      return wire.send(what.channel, AMQP_CHANNEL_CLOSE_OK_METHOD, amqp_channel_close_ok_t{});
  }
}

}  // namespace iotcloud::brokers::rabbitmq
