#include <algorithm>
#include <array>
#include <utility>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <thrift/TConfiguration.h>
#include <thrift/TProcessor.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include <iotcloud/rpc/connection.h>
#include <iotcloud/rpc/logger.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::rpc {

using apache::thrift::TConfiguration;
using apache::thrift::protocol::TBinaryProtocolFactory;
using apache::thrift::transport::TMemoryBuffer;

namespace {

/// A message's memory grows in steps of this size as bytes arrive, whatever length the message claims.
constexpr std::size_t growth = std::size_t{64} * 1024;

/// Why a client's connection ends.
struct Refused {
  std::string reason;  ///< label of the metric
  std::string text;
};

}  // namespace

ThriftConnection::ThriftConnection(const ThriftServerOptions& options, const ThriftService& service,
                                   std::shared_ptr<const security::TlsContext> tls, int descriptor, RefusalLog& log)
    : options_(options),
      service_(service),
      tls_(std::move(tls)),
      log_(log),
      stranger_until_(TcpStream::Clock::now() + options.stranger_limit),
      stream_(descriptor, tls_.get()),
      address_(stream_.peer_address()) {}

void ThriftConnection::stop() {
  stopping_ = true;
  stream_.cut_reading();
}

void ThriftConnection::refuse(const std::string& reason, const std::string& text) {
  log_.refused(reason, fmt::format("{}: {} is cut off: {}", options_.name, address_, text));
  count_refusal(options_.name, reason);
}

void ThriftConnection::serve() noexcept {
  try {
    open();
    while (!stopping_ && !peer_->hung_up()) answer(read_message());
  } catch (const Refused& refused) {
    refuse(refused.reason, refused.text);
  } catch (const TcpStreamError& e) {
    if (e.kind() == TcpStreamError::Kind::tls) {
      refuse("tls", e.what());
    } else if (e.kind() == TcpStreamError::Kind::timed_out) {
      refuse("slow", is_stranger() ? "it did not say in time who it is" : "a message took too long");
    } else {
      thrift_logger.debug("{}: {}: {}", options_.name, address_, e.what());
    }
  } catch (const apache::thrift::TException& e) {
    refuse("message", fmt::format("its message cannot be read: {}", e.what()));
  } catch (const std::exception& e) {
    refuse("message", fmt::format("its message cannot be answered: {}", e.what()));
  }
}

void ThriftConnection::open() {
  stream_.accept(stranger_until_);
  peer_ = std::make_shared<ThriftPeer>(address_, stream_.peer_certificate());
  peer_->set_user(stream_.peer_user());
  processor_ = service_(peer_);
  note_standing(false);
  const config::MutexLock lock(mutex_);
  certificate_ = stream_.shown_certificate();
}

void ThriftConnection::note_standing(bool answering) {
  auto is_valid = peer_->take_validity();
  const config::MutexLock lock(mutex_);
  if (is_valid) is_valid_ = std::move(is_valid);
  standing_ = {peer_->identity(), peer_->named(), answering, TcpStream::Clock::now()};
}

std::string ThriftConnection::distrust(const security::TlsContext* tls) const {
  security::ShownCertificate certificate;
  std::function<bool()> is_valid;
  {
    const config::MutexLock lock(mutex_);
    certificate = certificate_;
    is_valid = is_valid_;
  }
  if (tls != nullptr) {
    if (const auto why = tls->distrust(certificate); !why.empty()) return "its certificate is " + why;
  }
  return is_valid && !is_valid() ? "its token was taken away, or has expired" : "";
}

ThriftConnection::Standing ThriftConnection::standing() const {
  const config::MutexLock lock(mutex_);
  return standing_;
}

std::string ThriftConnection::read_message() {
  std::array<char, 4> head{};
  const auto idle_until = peer_->trusted() ? TcpStream::Clock::now() + options_.idle_limit : stranger_until_;
  std::size_t have = stream_.read_some(head.data(), head.size(), idle_until);
  const auto message_until = TcpStream::Clock::now() + options_.message_limit;
  const auto deadline = peer_->trusted() ? message_until : std::min(stranger_until_, message_until);
  while (have < head.size()) have += stream_.read_some(head.data() + have, head.size() - have, deadline);

  std::uint32_t claimed = 0;
  std::copy(head.begin(), head.end(), reinterpret_cast<char*>(&claimed));
  const std::size_t size = ntohl(claimed);
  const int most =
      std::min(options_.max_message_bytes, peer_->trusted() ? peer_->most_bytes() : options_.max_stranger_bytes);
  if (size > static_cast<std::size_t>(most))
    throw Refused{"size", fmt::format("a message of {} bytes, and {} is the limit{}", size, most,
                                      peer_->trusted() ? " for it" : " for those who are not known yet")};
  std::string message;
  while (message.size() < size) {
    const std::size_t before = message.size();
    message.resize(std::min(size, before + growth));
    message.resize(before + stream_.read_some(message.data() + before, message.size() - before, deadline));
  }
  return message;
}

bool answer_message(apache::thrift::TProcessor& processor, const std::string& message, int max_items,
                    std::string& answer) {
  const int size = static_cast<int>(message.size());
  TBinaryProtocolFactory protocols(size, max_items, false, true);
  // Thrift does not write to memory that it observes. It accepts no length in this message beyond the message's own.
  auto* const bytes = reinterpret_cast<std::uint8_t*>(const_cast<char*>(message.data()));
  const auto input = std::make_shared<TMemoryBuffer>(bytes, static_cast<std::uint32_t>(size), TMemoryBuffer::OBSERVE,
                                                     std::make_shared<TConfiguration>(size, size));
  const auto output = std::make_shared<TMemoryBuffer>();
  std::uint32_t length = 0;
  output->write(reinterpret_cast<const std::uint8_t*>(&length), sizeof length);  // reserves room for the length
  const bool go_on = processor.process(protocols.getProtocol(input), protocols.getProtocol(output), nullptr);
  if (output->available_read() > sizeof length) {
    answer = output->getBufferAsString();
    length = htonl(static_cast<std::uint32_t>(answer.size() - sizeof length));
    std::copy_n(reinterpret_cast<const char*>(&length), sizeof length, answer.begin());
  }
  return go_on;
}

void ThriftConnection::answer(const std::string& message) {
  std::string bytes;
  note_standing(true);
  const bool go_on = answer_message(*processor_, message, options_.max_items, bytes);
  if (!go_on) throw Refused{"message", "it sends what is no call"};
  // Trust the client before the answer is sent: a client that has got an answer relies on its connection.
  if (!peer_->asked()) peer_->trust();
  trusted_ = peer_->trusted();
  // This connection, too, is noted before the answer is sent: a client that has got it may connect again, and the
  // server then counts this connection.
  note_standing(true);
  stream_.write_all(bytes.data(), bytes.size(), TcpStream::Clock::now() + options_.message_limit);
  peer_->release();
  note_standing(false);
}

}  // namespace iotcloud::rpc
