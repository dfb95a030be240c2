#pragma once

#include <array>
#include <chrono>
#include <memory>
#include <string>
#include <utility>

#include <thrift/TProcessor.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/protocol/TProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include <iotcloud/config/metrics.h>
#include <iotcloud/rpc/tcp_stream.h>
#include <iotcloud/rpc/thrift_client.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::rpc::test {

/// The longest that a test waits before it fails.
using tests::patience;

/// Reads a call, whatever its arguments are. \return its method and number.
inline std::pair<std::string, std::int32_t> read_call(apache::thrift::protocol::TProtocol& in) {
  using namespace apache::thrift::protocol;
  std::string method;
  TMessageType type{};
  std::int32_t number = 0;
  in.readMessageBegin(method, type, number);
  in.skip(T_STRUCT);
  in.readMessageEnd();
  return {method, number};
}

/// Answers each call of the method "size:N" with N bytes, any other with "hello", whatever its arguments are.
class Greeter final : public apache::thrift::TProcessor {
 public:
  bool process(std::shared_ptr<apache::thrift::protocol::TProtocol> in,
               std::shared_ptr<apache::thrift::protocol::TProtocol> out, void*) override {
    const auto [method, number] = read_call(*in);
    out->writeMessageBegin(method, apache::thrift::protocol::T_REPLY, number);
    out->writeString(method.starts_with("size:") ? std::string(std::stoul(method.substr(5)), 'x') : "hello");
    out->writeMessageEnd();
    return true;
  }
};

/// The frame of a call without arguments, or with one list that claims to have this many items.
inline std::string call_frame(const std::string& method, std::int32_t claimed_items = -1) {
  using namespace apache::thrift::protocol;
  const auto buffer = std::make_shared<apache::thrift::transport::TMemoryBuffer>();
  const auto framed = std::make_shared<apache::thrift::transport::TFramedTransport>(buffer);
  TBinaryProtocol out(framed);
  out.writeMessageBegin(method, T_CALL, 1);
  if (claimed_items >= 0) {
    out.writeFieldBegin("items", T_LIST, 1);
    out.writeListBegin(T_I64, static_cast<std::uint32_t>(claimed_items));
  }
  out.writeFieldStop();
  out.writeMessageEnd();
  framed->flush();
  return buffer->getBufferAsString();
}

/// A well-behaved client's call. \return the answer. \throws TException
inline std::string ask(const ThriftClient& client, const std::string& method = "greet") {
  using namespace apache::thrift::protocol;
  const auto protocol = client.protocol();
  protocol->writeMessageBegin(method, T_CALL, 1);
  protocol->writeFieldStop();
  protocol->writeMessageEnd();
  protocol->getTransport()->flush();
  std::string name, answer;
  TMessageType type{};
  std::int32_t number = 0;
  protocol->readMessageBegin(name, type, number);
  protocol->readString(answer);
  return answer;
}

inline std::uint64_t refusals(const std::string& service, const std::string& reason) {
  return config::process_metrics()
      .counter("iotcloud_thrift_refused_total", "", {{"service", service}, {"reason", reason}})
      .value();
}

/// A raw socket, for clients that break the rules of the protocol.
class RawClient {
 public:
  explicit RawClient(int port)
      : stream_(TcpStream::connect("127.0.0.1", port, nullptr, TcpStream::Clock::now() + patience)) {}
  void send(const std::string& bytes) {
    stream_->write_all(bytes.data(), bytes.size(), TcpStream::Clock::now() + patience);
  }
  /// Waits for one answer. \return whether it came before the connection was closed
  bool is_answered() {
    char byte = 0;
    try {
      stream_->read_some(&byte, 1, TcpStream::Clock::now() + patience);
      return true;
    } catch (const TcpStreamError& e) {
      if (e.kind() == TcpStreamError::Kind::timed_out) throw;
      return false;
    }
  }
  /// Reads until the connection is closed. \return false if that does not happen
  bool is_cut_off() {
    std::array<char, 4096> ignored{};
    try {
      while (true) stream_->read_some(ignored.data(), ignored.size(), TcpStream::Clock::now() + patience);
    } catch (const TcpStreamError& e) {
      return e.kind() != TcpStreamError::Kind::timed_out;
    }
  }
  /// Sends a byte every few milliseconds. \return whether the server closed the connection in the end
  bool is_cut_off_dripping() {
    try {
      for (int i = 0; i < 10'000; ++i) {
        send("x");
        char byte = 0;
        try {
          stream_->read_some(&byte, 1, TcpStream::Clock::now() + std::chrono::milliseconds(2));
        } catch (const TcpStreamError& e) {
          if (e.kind() != TcpStreamError::Kind::timed_out) return true;
        }
      }
      return false;
    } catch (const TcpStreamError&) {
      return true;
    }
  }

 private:
  std::unique_ptr<TcpStream> stream_;
};

inline ThriftClientOptions client_of(int port) {
  ThriftClientOptions options;
  options.host = "127.0.0.1";
  options.port = port;
  options.connect_limit = patience;
  options.answer_limit = patience;
  return options;
}

}  // namespace iotcloud::rpc::test
