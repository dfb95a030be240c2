#include "iotcloud/brokers/rabbitmq/read_connection.h"

#include <algorithm>
#include <utility>

#include "iotcloud/brokers/client/burst.h"
#include <iotcloud/brokers/rabbitmq/logger.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

// The most handlers in a row before the socket is checked and settlements are sent.
constexpr std::size_t batch = 64;
// How long acknowledgements may gather, so that one covers many messages.
constexpr std::chrono::milliseconds gathering_time{2};

// The most frames, and bytes of bodies, read in a row before handlers run: the bytes read last are still in the
// processor's cache, but megabytes would not be.
constexpr std::size_t frames_in_a_row = 1024;
constexpr std::size_t bytes_in_a_row = 131072;
// The most subscriptions requested at once: the server may need milliseconds for each, so the last of thousands would
// exceed the time limit for an answer.
constexpr std::size_t most_opening = 64;

}  // namespace

ReadConnection::WireTurn::WireTurn(ReadConnection& link) : link_(link) {
  while (link.wire_taken_) link.wire_free_.wait(link.core_.mutex);
  link.wire_taken_ = true;
}

ReadConnection::WireTurn::~WireTurn() {
  link_.wire_taken_ = false;
  link_.buffered_ = link_.wire_ && link_.wire_->has_buffered();
  link_.wire_free_.notify_one();
}

ReadConnection::ReadConnection(const Cluster& cluster, const char* purpose, Meters& meters, const config::Clock& clock,
                               ConnectionLog& log)
    : cluster_(cluster),
      purpose_(purpose),
      meters_(meters),
      clock_(clock),
      core_(*this, meters, clock, gathering_time),
      channel_limit_(static_cast<std::size_t>(cluster.channels())),
      life_("amqp-consume", *this, core_.mutex, sleep_, cluster, clock, log) {}

void ReadConnection::close() {
  {
    const config::MutexLock lock(core_.mutex);
    if (!life_.begin_to_end()) return;
    core_.stop();
  }
  life_.join();
  // Readers own their connection, so the connection must drop its references to them, or neither would be destroyed.
  const config::MutexLock lock(core_.mutex);
  forget();
}

std::shared_ptr<QueueReader> ReadConnection::add(const Topic& topic, const SubscriptionOptions& options,
                                                 Handler handler) {
  auto reader =
      std::make_shared<QueueReader>(shared_from_this(), cluster_.queue_type(), topic, options, std::move(handler));
  const config::MutexLock lock(core_.mutex);
  readers_.push_back(reader);
  set_timer(*reader, clock_.now());
  life_.start();
  return reader;
}

bool ReadConnection::has_room() const {
  const config::MutexLock lock(core_.mutex);
  return readers_.size() < channel_limit_;
}

bool ReadConnection::over_limit() const {
  const config::MutexLock lock(core_.mutex);
  return readers_.size() > channel_limit_;
}

void ReadConnection::share(ReadConnection& other) {
  const config::MutexLock lock(core_.mutex);
  const config::MutexLock others(other.core_.mutex);
  for (auto i = readers_.size(); i-- > 0 && readers_.size() > channel_limit_;) {
    if (other.readers_.size() >= other.channel_limit_) break;
    const std::shared_ptr<QueueReader> reader = readers_[i];
    if (reader->phase != QueueReader::Phase::idle || reader->Subscriber::running) continue;
    readers_.erase(readers_.begin() + static_cast<std::ptrdiff_t>(i));
    core_.forget(*reader);
    other.set_timer(*reader, clock_.now());
    reader->move_to(other.shared_from_this());
    other.readers_.push_back(reader);
  }
  other.life_.start();
}

bool ReadConnection::remove(const std::shared_ptr<QueueReader>& reader) {
  const config::MutexLock lock(core_.mutex);
  if (!reads_here(*reader)) return false;
  core_.end(*reader);
  std::erase(readers_, reader);
  if (reader->phase != QueueReader::Phase::idle) {
    leaving_.push_back(reader);
    write_or_leave();
  }
  core_.await_handler(*reader);
  return true;
}

bool ReadConnection::pause(QueueReader& reader) {
  const config::MutexLock lock(core_.mutex);
  if (!reads_here(reader)) return false;
  core_.pause(reader);
  return true;
}

std::optional<bool> ReadConnection::raise_prefetch(const std::shared_ptr<QueueReader>& reader, std::uint16_t prefetch) {
  const config::MutexLock lock(core_.mutex);
  if (!reads_here(*reader)) return std::nullopt;
  if (!reader->may_raise()) return false;
  if (prefetch <= reader->prefetch) return true;
  reader->prefetch = prefetch;
  if (reader->phase == QueueReader::Phase::idle) return true;  // its next request names the new prefetch
  raised_.push_back(reader);
  write_or_leave();
  return true;
}

bool ReadConnection::backlog(const std::shared_ptr<QueueReader>& reader, std::optional<std::uint64_t>& last) {
  const config::MutexLock lock(core_.mutex);
  if (!reads_here(*reader)) return false;
  last = reader->backlog;
  if (reader->phase != QueueReader::Phase::active || std::exchange(reader->asks, true)) return true;
  asking_.push_back(reader);
  write_or_leave();
  return true;
}

bool ReadConnection::resume(QueueReader& reader) {
  const config::MutexLock lock(core_.mutex);
  if (!reads_here(reader)) return false;
  core_.resume(reader);
  return true;
}

bool ReadConnection::active(const QueueReader& reader) const {
  const config::MutexLock lock(core_.mutex);
  return reads_here(reader) && reader.phase == QueueReader::Phase::active;
}

ConnectionState ReadConnection::state() const {
  const config::MutexLock lock(core_.mutex);
  if (life_.ending()) return ConnectionState::closed;
  return !life_.started() || wire_ ? ConnectionState::connected : ConnectionState::connecting;
}

void ReadConnection::settle(QueueReader& reader, std::uint64_t public_tag, Settlement settlement) noexcept {
  const config::MutexLock lock(core_.mutex);
  // Otherwise the reader has moved, and the settlement is late.
  if (reads_here(reader)) core_.settle(reader, public_tag, settlement);
}

void ReadConnection::settled(client::DeliveryStream& stream, bool /*first*/) noexcept {
  // Normally the connection's thread sends settlements after its handlers. This thread does if that thread sleeps, or
  // is busy while unsent settlements use up much of the prefetch.
  if (core_.hands_on_here() || (!life_.sleeps() && stream.window.settled() <= stream.patience())) return;
  if (!wire_ || life_.broken()) return;
  if (core_.settlements_due()) {
    write_or_leave();
  } else {
    sleep_.signal_after(core_.gathered_at() - clock_.now());
  }
}

void ReadConnection::wake() noexcept {
  life_.wake();
}

void ReadConnection::write_or_leave() noexcept {
  if (!wire_ || life_.broken()) return;
  left_for_wire_ = true;
  if (wire_taken_) return;
  try {
    const WireTurn turn(*this);
    wire_role_.assert_held();
    write_all();
  } catch (...) {
    life_.broke();
  }
  if (unwritten_ || buffered_) wake();
}

void ReadConnection::open(std::size_t server) {
  spare_ = cluster_.connect(server, purpose_, Login::reader);
}

std::shared_ptr<ShownChain> ReadConnection::opened() {
  core_.mutex.assert_held();
  wire_ = std::move(spare_);
  channel_limit_ = static_cast<std::size_t>(wire_->channel_limit());
  for (const auto& reader : readers_) set_timer(*reader, clock_.now());
  return wire_->shown();
}

void ReadConnection::serve(ConnectionLife::Readiness ready) {
  core_.mutex.assert_held();
  const WireTurn turn(*this);
  wire_role_.assert_held();
  channels_.socket_has_room(ready.writable);
  check_timers();
  write();
  if (ready.readable || wire_->has_buffered()) {
    const config::Unlocked unlocked(core_.mutex);
    read_frames();
  }
  write();
  if (left_for_wire_) write_all();
}

void ReadConnection::call_back() {
  core_.mutex.assert_held();
  hand_on();
  write_due();
}

void ReadConnection::write_due() {
  if (!wire_ || life_.broken()) return;
  if (!unwritten_ && !left_for_wire_ && leaving_.empty() && !core_.settlements_due()) return;
  const WireTurn turn(*this);
  wire_role_.assert_held();
  write_all();
}

ConnectionLife::Rest ReadConnection::rest() {
  core_.mutex.assert_held();
  ConnectionLife::Rest rest;
  rest.unread = wire_ && buffered_;
  const bool more = (core_.has_ready() && !life_.moving()) || left_for_wire_;
  if (!more) rest.limit = time_to_sleep();
  if (wire_) rest.socket = wire_->descriptor();
  rest.want_write = unwritten_;
  return rest;
}

std::chrono::milliseconds ReadConnection::time_to_sleep() const {
  if (!wire_) return std::chrono::minutes(1);
  const Instant now = clock_.now();
  const auto until = [&](Instant instant) {
    return std::max(std::chrono::milliseconds(0), std::chrono::ceil<std::chrono::milliseconds>(instant - now));
  };
  std::chrono::milliseconds limit = std::chrono::milliseconds(wire_->heartbeat()) / 2;
  if (next_timer_) limit = std::min(limit, until(*next_timer_));
  if (!core_.dirty().empty()) limit = std::min(limit, until(core_.gathered_at()));
  return limit;
}

bool ReadConnection::idle() const {
  core_.mutex.assert_held();
  return std::all_of(readers_.begin(), readers_.end(),
                     [](const auto& reader) { return reader->window.handed_on() == 0; });
}

void ReadConnection::finish() {
  core_.mutex.assert_held();
  const WireTurn turn(*this);
  wire_role_.assert_held();
  for (const auto& reader : readers_) {
    if (reader->channel != 0) channels_.settle(*reader, 0);
  }
  gather();
  const config::Unlocked unlocked(core_.mutex);
  channels_.write_all(*wire_);
}

void ReadConnection::forget() {
  core_.mutex.assert_held();
  const WireTurn turn(*this);
  wire_role_.assert_held();
  spare_ = std::move(wire_);
  left_for_wire_ = unwritten_ = openers_wait_ = false;
  channels_.clear();
  leaving_.clear();
  asking_.clear();
  core_.connection_lost();
  for (const auto& reader : readers_) {
    reader->forget_channel();
    reader->backoff.reset();
  }
}

void ReadConnection::close(bool in_order) noexcept {
  if (in_order) spare_->close(0);
  spare_.reset();
}

void ReadConnection::hand_on() {
  if (!core_.has_ready() || life_.moving()) return;
  std::optional<client::Burst> burst(std::in_place, clock_);
  {
    ReadCore::Turn turn(core_);
    for (std::size_t i = 0; i < batch; ++i) {
      auto* const reader = static_cast<QueueReader*>(core_.take(turn));
      if (reader == nullptr) break;
      burst->before_handler(core_.has_ready() && i + 1 < batch, reader->quick);
      core_.run(turn);
      reader->quick = burst->after_handler().value_or(reader->quick);
    }
  }
  // Ends the burst, which sends what the handlers published on other connections.
  const config::Unlocked unlocked(core_.mutex);
  burst.reset();
}

void ReadConnection::read_during_handler() {
  const config::MutexLock lock(core_.mutex);
  // A user's thread that has the WireTurn needs it only for a moment.
  if (!core_.hands_on() || !wire_ || life_.broken() || wire_taken_) return;
  try {
    const WireTurn turn(*this);
    wire_role_.assert_held();
    check_timers();
    {
      const config::Unlocked unlocked(core_.mutex);
      read_frames();
    }
    write_all();
  } catch (...) {
    life_.broke();
  }
  wake();  // the connection's thread may sleep by now, and there may be messages to hand on
}

bool ReadConnection::handlers_wait() const {
  const config::MutexLock lock(core_.mutex);
  return core_.has_ready() && !core_.hands_on();
}

void ReadConnection::read_frames() {
  std::size_t count = 0;
  std::size_t bytes = 0;
  do {
    const std::optional<amqp_frame_t> frame = wire_->next_frame();
    if (!frame) return;
    if (frame->frame_type == AMQP_FRAME_BODY) bytes += frame->payload.body_fragment.len;
    on_frame(*frame);
    wire_->release(frame->channel);
    if (bytes >= bytes_in_a_row && handlers_wait()) return;
  } while (wire_->has_buffered() && ++count < frames_in_a_row);
}

void ReadConnection::on_frame(const amqp_frame_t& frame) {
  if (frame.frame_type == AMQP_FRAME_METHOD) {
    on_method(frame.payload.method, frame.channel);
    return;
  }
  const auto found = channels_.find(frame.channel);
  if (!found || *found == nullptr) return;
  QueueReader& reader = **found;
  std::optional<Arrived> complete;
  if (frame.frame_type == AMQP_FRAME_HEADER) {
    complete = reader.assembly.header(frame, reader.resent);
  } else if (frame.frame_type == AMQP_FRAME_BODY) {
    complete = reader.assembly.body(frame.payload.body_fragment);
  }
  if (complete) on_arrived(reader, std::move(*complete));
}

void ReadConnection::on_arrived(QueueReader& reader, Arrived arrived) {
  const bool too_many_headers = reader.assembly.too_many_headers();
  const config::MutexLock lock(core_.mutex);
  // Its channel is about to be closed, and the server delivers its messages to another reader.
  if (reader.closed) return;
  if (!arrived.redelivered && reader.doubtful > 0) {
    --reader.doubtful;
    arrived.redelivered = true;
  }
  if (too_many_headers) {
    logger.warn("queue {} held a message with too many headers; it is skipped", reader.queue);
    meters_.skipped(reason::undecodable);
    core_.skipped(reader);
    return;
  }
  if (!core_.arrived(reader, std::move(arrived))) throw LinkError("a delivery out of turn");
}

void ReadConnection::on_method(const amqp_method_t& method, amqp_channel_t channel) {
  if (method.id == AMQP_CONNECTION_CLOSE_METHOD) {
    throw LinkError("the server closed it: " + describe(*static_cast<const amqp_connection_close_t*>(method.decoded)));
  }
  const auto found = channels_.find(channel);
  if (!found) return;
  QueueReader* const reader = *found;  // null: this client has requested the channel's end
  if (method.id == AMQP_BASIC_DELIVER_METHOD) {
    if (reader != nullptr) reader->assembly.begin(*static_cast<const amqp_basic_deliver_t*>(method.decoded));
    return;
  }
  const config::MutexLock lock(core_.mutex);
  switch (method.id) {
    case AMQP_QUEUE_DECLARE_OK_METHOD:
      if (reader == nullptr) return;
      if (const auto count = static_cast<const amqp_queue_declare_ok_t*>(method.decoded)->message_count;
          reader->phase == QueueReader::Phase::active) {
        reader->backlog = count;
        reader->asks = false;
      } else if (reader->read_before) {
        reader->doubtful = count;
      }
      return;
    case AMQP_BASIC_CONSUME_OK_METHOD:
      if (reader != nullptr) reader->reading_began();
      return answered();
    case AMQP_CHANNEL_CLOSE_METHOD:
      return on_channel_closed(reader, *static_cast<const amqp_channel_close_t*>(method.decoded), channel);
    case AMQP_CHANNEL_CLOSE_OK_METHOD:
      channels_.closed(channel);
      return answered();
    case AMQP_BASIC_CANCEL_METHOD:  // the queue was deleted
      if (reader == nullptr || reader->closed) return;
      channels_.close(*reader);
      return retry_later(*reader);
    default:  // other answers to a request; only the last one, consume-ok, matters
      return;
  }
}

void ReadConnection::on_channel_closed(QueueReader* reader, const amqp_channel_close_t& why, amqp_channel_t channel) {
  if (reader != nullptr && reader->closed) {
    reader->forget_channel();
  } else if (reader != nullptr) {
    reader->refused(why);
    retry_later(*reader);
  }
  channels_.closed_by_server(channel);
  answered();
}

void ReadConnection::answered() {
  if (std::exchange(openers_wait_, false)) next_timer_ = clock_.now();
}

void ReadConnection::retry_later(QueueReader& reader) {
  set_timer(reader, clock_.now() + reader.backoff.next());
}

void ReadConnection::request(const std::shared_ptr<QueueReader>& reader) {
  const auto limit = static_cast<amqp_channel_t>(wire_->channel_limit());
  if (channels_.size() >= limit) {
    retry_later(*reader);  // until a closing channel becomes free, or the keeper finds another connection
    return;
  }
  reader->phase = QueueReader::Phase::opening;
  set_timer(*reader, clock_.now() + cluster_.rpc_timeout());
  channels_.open(reader);
}

void ReadConnection::set_timer(QueueReader& reader, Instant at) {
  reader.retry_at = at;
  if (!next_timer_ || at < *next_timer_) next_timer_ = at;
}

void ReadConnection::check_timers() {
  if (!next_timer_) return;
  const Instant now = clock_.now();
  if (*next_timer_ > now) return;
  next_timer_.reset();
  std::size_t opening =
      static_cast<std::size_t>(std::count_if(readers_.begin(), readers_.end(), [](const auto& reader) {
        return reader->phase == QueueReader::Phase::opening;
      }));
  for (const auto& reader : readers_) {
    if (!reader->retry_at) continue;
    const Instant at = *reader->retry_at;
    if (at > now) {
      set_timer(*reader, at);
      continue;
    }
    if (reader->phase == QueueReader::Phase::opening)
      throw LinkError("no answer to the request to read " + reader->queue);
    if (reader->phase == QueueReader::Phase::idle && opening >= most_opening) {
      openers_wait_ = true;
      continue;
    }
    reader->retry_at.reset();
    if (reader->phase != QueueReader::Phase::idle) continue;
    request(reader);
    if (reader->phase == QueueReader::Phase::opening) ++opening;
  }
}

void ReadConnection::gather() {
  for (const auto& stream : core_.take_dirty()) {
    auto& reader = static_cast<QueueReader&>(*stream);
    if (!reader.closed && reader.channel != 0) channels_.settle(reader, reader.patience());
  }
  for (const auto& reader : std::exchange(raised_, {})) {
    if (!reads_here(*reader) || reader->closed || reader->channel == 0 || !reader->may_raise()) continue;
    channels_.limit(*reader);
  }
  for (const auto& reader : std::exchange(asking_, {})) {
    if (reads_here(*reader) && !reader->closed && reader->asks) channels_.ask(reader);
  }
  for (const auto& reader : std::exchange(leaving_, {})) {
    if (reader->channel == 0) continue;  // the server has closed its channel
    channels_.settle(*reader, 0);
    channels_.close(*reader);
  }
}

void ReadConnection::write() {
  if (!channels_.all_written()) {
    const config::Unlocked unlocked(core_.mutex);
    channels_.write(*wire_);
  }
  unwritten_ = !channels_.all_written();
}

void ReadConnection::write_all() {
  do {
    left_for_wire_ = false;
    gather();
    write();
  } while (left_for_wire_ && !unwritten_);
  left_for_wire_ = false;  // the rest is written when the socket is writable
}

}  // namespace iotcloud::brokers::rabbitmq
