#include "iotcloud/brokers/rabbitmq/consuming/inlet.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "iotcloud/brokers/rabbitmq/consuming/consume_link.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/headers.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

/// No sane message is larger; a server that says so has lost its mind or is none.
constexpr std::uint64_t body_limit = std::uint64_t{1} << 30U;
/// A frame holds many thousands of small headers; looking each up among the others would take its time.
constexpr int header_limit = 2000;

}  // namespace

void Assembly::begin(const amqp_basic_deliver_t& deliver) {
  reset();
  arrived_.tag = deliver.delivery_tag;
  arrived_.redelivered = deliver.redelivered != 0;
  expects_header_ = true;
}

std::optional<Arrived> Assembly::header(const amqp_frame_t& frame, ResentMarks& resent) {
  if (!std::exchange(expects_header_, false)) throw LinkError("a message's header without a delivery");
  const std::uint64_t size = frame.payload.properties.body_size;
  if (size > body_limit) throw LinkError("a message of " + std::to_string(size) + " bytes");
  const auto& properties = *static_cast<const amqp_basic_properties_t*>(frame.payload.properties.decoded);
  hostile_ = (properties._flags & AMQP_BASIC_HEADERS_FLAG) != 0 && properties.headers.num_entries > header_limit;
  if (!hostile_) {
    const bool marked = decode_properties(properties, arrived_.message);
    if (resent.may_be_a_copy(origin_of(properties), marked)) arrived_.redelivered = true;
  }
  size_ = static_cast<std::size_t>(size);
  if (size_ == 0) return finish();
  bytes_ = std::shared_ptr<std::byte[]>(new std::byte[size_]);  // not cleared: it is all overwritten
  return std::nullopt;
}

std::optional<Arrived> Assembly::body(amqp_bytes_t piece) {
  if (!bytes_ || piece.len > size_ - filled_) throw LinkError("a message's body that does not fit its header");
  std::memcpy(bytes_.get() + filled_, piece.bytes, piece.len);
  filled_ += piece.len;
  if (filled_ < size_) return std::nullopt;
  return finish();
}

std::optional<Arrived> Assembly::finish() {
  if (size_ > 0) {
    const std::span<const std::byte> bytes(bytes_.get(), size_);
    arrived_.message.payload = Payload::wrap(std::move(bytes_), bytes);
  }
  std::optional<Arrived> done(std::move(arrived_));
  const bool hostile = hostile_;
  reset();
  hostile_ = hostile;
  return done;
}

Inlet::Inlet(std::shared_ptr<ConsumeLink> link, Topic to, SubscriptionOptions how, Handler what)
    : topic(std::move(to)),
      options(std::move(how)),
      handler(std::move(what)),
      queue(options.group.empty() ? topic.name : topic.name + "." + options.group),
      home_(std::move(link)) {}

void Inlet::settle(std::uint64_t tag, Settlement settlement) noexcept {
  home()->settle(shared_from_this(), tag, settlement);
}

std::shared_ptr<ConsumeLink> Inlet::home() const {
  const std::lock_guard lock(home_mutex_);
  return home_;
}

void Inlet::move_to(std::shared_ptr<ConsumeLink> link) {
  const std::lock_guard lock(home_mutex_);
  home_ = std::move(link);
}

void Inlet::forget_channel() {
  phase = Phase::idle;
  channel = 0;
  ++generation;
  window.clear();
  assembly.reset();
}

}  // namespace iotcloud::brokers::rabbitmq
