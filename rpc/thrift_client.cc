#include <optional>

#include <fmt/format.h>
#include <thrift/TConfiguration.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/protocol/TProtocolException.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TTransportException.h>
#include <thrift/transport/TVirtualTransport.h>

#include <iotcloud/config/error.h>
#include <iotcloud/rpc/tcp_stream.h>
#include <iotcloud/rpc/thrift_client.h>

namespace iotcloud::rpc {

using apache::thrift::TConfiguration;
using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::protocol::TProtocol;
using apache::thrift::protocol::TProtocolException;
using apache::thrift::transport::TFramedTransport;
using apache::thrift::transport::TTransportException;
using apache::thrift::transport::TVirtualTransport;

namespace {

/// The longest list in an answer: as many records as the largest answer has room for, at so many bytes each. Thrift
/// makes room for a list before it reads the first element, so whoever answers may not choose any length.
constexpr int bytes_of_item = 160;

TTransportException exception_of(const TcpStreamError& e) {
  switch (e.kind()) {
    case TcpStreamError::Kind::ended:
      return {TTransportException::END_OF_FILE, e.what()};
    case TcpStreamError::Kind::timed_out:
      return {TTransportException::TIMED_OUT, e.what()};
    case TcpStreamError::Kind::tls:
    case TcpStreamError::Kind::broken:
      break;
  }
  return {TTransportException::NOT_OPEN, e.what()};
}

}  // namespace

class ThriftClient::Transport final : public TVirtualTransport<Transport> {
 public:
  explicit Transport(const ThriftClientOptions& options)
      : TVirtualTransport(std::make_shared<TConfiguration>(options.most_bytes, options.most_bytes)),
        limit_(options.answer_limit) {
    if (!options.tls.empty()) tls_.emplace(options.tls, security::TlsContext::Side::client);
    try {
      stream_ = TcpStream::connect(options.host, options.port, tls_ ? &*tls_ : nullptr,
                                   TcpStream::Clock::now() + options.connect_limit);
    } catch (const TcpStreamError& e) {
      throw exception_of(e);
    }
    if (options.tls.empty() || !options.daemon || stream_->is_peer(*options.daemon)) return;
    const auto kind = to_string(options.daemon->kind);
    const auto& id = options.daemon->id;
    throw TTransportException(
        TTransportException::NOT_OPEN,
        fmt::format("the certificate there is of {}, not of {} {}; make it one with `iotcloud certs add DIR --host "
                    "HOST --{} {}`",
                    stream_->peer_certificate(), kind, id, kind, id));
  }

  bool isOpen() const override { return stream_ != nullptr; }
  void close() override { stream_.reset(); }

  std::uint32_t read(std::uint8_t* to, std::uint32_t size) {
    return use([&](TcpStream& stream) { return static_cast<std::uint32_t>(stream.read_some(to, size, deadline_)); });
  }
  void write(const std::uint8_t* from, std::uint32_t size) {
    deadline_ = TcpStream::Clock::now() + limit_;
    use([&](TcpStream& stream) {
      stream.write_all(from, size, deadline_);
      return 0U;
    });
  }
  void flush() override {}

  void set_limit(std::chrono::milliseconds limit) { limit_ = limit; }

 private:
  template <typename Use>
  std::uint32_t use(Use&& use) {
    if (!stream_) throw TTransportException(TTransportException::NOT_OPEN, "the connection is closed");
    try {
      return use(*stream_);
    } catch (const TcpStreamError& e) {
      throw exception_of(e);
    }
  }

  std::chrono::milliseconds limit_;
  TcpStream::Clock::time_point deadline_ = TcpStream::never;
  std::optional<security::TlsContext> tls_;
  std::unique_ptr<TcpStream> stream_;
};

ThriftClient::ThriftClient(const ThriftClientOptions& options)
    : most_bytes_(options.most_bytes), transport_(std::make_shared<Transport>(options)) {}

ThriftClient::~ThriftClient() = default;

std::shared_ptr<TProtocol> ThriftClient::protocol() const {
  return std::make_shared<TBinaryProtocol>(
      std::make_shared<TFramedTransport>(transport_, std::make_shared<TConfiguration>(most_bytes_, most_bytes_)),
      most_bytes_, most_bytes_ / bytes_of_item, false, true);
}

bool ThriftClient::is_too_large(const apache::thrift::TException& error) {
  if (const auto* of_protocol = dynamic_cast<const TProtocolException*>(&error))
    return of_protocol->getType() == TProtocolException::SIZE_LIMIT;
  const auto* of_transport = dynamic_cast<const TTransportException*>(&error);
  return of_transport != nullptr &&
         of_transport->getType() == TTransportException::CORRUPTED_DATA;  // of a frame's size
}

void ThriftClient::set_answer_limit(std::chrono::milliseconds limit) {
  transport_->set_limit(limit);
}

}  // namespace iotcloud::rpc
