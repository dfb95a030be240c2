#include <exception>
#include <future>
#include <thread>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <thrift/TConfiguration.h>
#include <thrift/TOutput.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/server/TThreadedServer.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TServerSocket.h>
#include <thrift/transport/TTransportException.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/master/api/thrift_server.h>

namespace iotcloud::master {

using apache::thrift::TConfiguration;
using apache::thrift::TProcessorFactory;
using apache::thrift::protocol::TBinaryProtocolFactory;
using apache::thrift::server::TServerEventHandler;
using apache::thrift::server::TThreadedServer;
using apache::thrift::transport::TFramedTransport;
using apache::thrift::transport::TServerSocket;
using apache::thrift::transport::TTransport;
using apache::thrift::transport::TTransportFactory;

namespace {

constexpr config::Logger logger{"master.thrift"};

/// Thrift's own has no way to pass the limits.
class LimitedFrames final : public TTransportFactory {
 public:
  explicit LimitedFrames(int max_bytes) : max_bytes_(max_bytes) {}
  std::shared_ptr<TTransport> getTransport(std::shared_ptr<TTransport> socket) override {
    return std::make_shared<TFramedTransport>(std::move(socket),
                                              std::make_shared<TConfiguration>(max_bytes_, max_bytes_));
  }

 private:
  const int max_bytes_;
};

/// Tells once whether the server listens.
class Listening final : public TServerEventHandler {
 public:
  std::future<void> result() { return promise_.get_future(); }
  void preServe() override {
    listens_ = true;
    promise_.set_value();
  }
  /// The server ended with `error`, in the thread that serves.
  void ended(std::exception_ptr error, const char* text) {
    if (listens_) {
      logger.error("the Thrift server ended: {}", text);
    } else {
      promise_.set_exception(std::move(error));
    }
  }

 private:
  std::promise<void> promise_;
  bool listens_ = false;  ///< of the thread that serves
};

/// The library would print to stderr by itself, past the log.
void keep_library_quiet() {
  static const bool done = [] {
    apache::thrift::GlobalOutput.setOutputFunction([](const char* text) { logger.debug("{}", text); });
    return true;
  }();
  (void)done;
}

}  // namespace

bool is_loopback(const std::string& host) {
  if (host == "localhost" || host == "::1") return true;
  in_addr address{};
  return inet_pton(AF_INET, host.c_str(), &address) == 1 && (ntohl(address.s_addr) >> 24) == 127;
}

struct ThriftServer::Impl {
  std::shared_ptr<TServerSocket> socket;
  std::unique_ptr<TThreadedServer> server;
  std::jthread thread;
};

ThriftServer::ThriftServer(const ThriftServerOptions& options, std::shared_ptr<TProcessorFactory> processors)
    : impl_(std::make_unique<Impl>()) {
  keep_library_quiet();
  impl_->socket = std::make_shared<TServerSocket>(options.host, options.port);
  impl_->socket->setSendTimeout(10'000);  // a client that does not read its answer loses its connection
  impl_->socket->setKeepAlive(true);
  impl_->server = std::make_unique<TThreadedServer>(
      std::move(processors), impl_->socket, std::make_shared<LimitedFrames>(options.max_message_bytes),
      std::make_shared<TBinaryProtocolFactory>(options.max_message_bytes, options.max_items, false, true));
  impl_->server->setConcurrentClientLimit(options.max_connections);

  const auto listening = std::make_shared<Listening>();
  auto result = listening->result();
  impl_->server->setServerEventHandler(listening);
  impl_->thread = std::jthread([server = impl_->server.get(), listening] {
    try {
      server->serve();
    } catch (const std::exception& e) {
      listening->ended(std::current_exception(), e.what());
    }
  });
  try {
    result.get();
  } catch (const std::exception& e) {
    throw config::Error(fmt::format("cannot listen on {}:{}: {}; is another program using the port?", options.host,
                                    options.port, e.what()));
  }
}

ThriftServer::~ThriftServer() {
  impl_->server->stop();
  impl_->thread.join();
}

int ThriftServer::port() const {
  return impl_->socket->getPort();
}

}  // namespace iotcloud::master
