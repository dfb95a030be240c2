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

#include <iotcloud/config/log.h>
#include <iotcloud/gateway/site/site_handler.h>
#include <iotcloud/gateway/site/site_service.h>

namespace iotcloud::gateway {

namespace thrift = apache::thrift;

namespace {

constexpr config::Logger log{"gateway.thrift"};
constexpr int send_limit_ms = 10'000;  // a client that does not read its answer loses its connection

/// Frames of limited size; the library's own factory has no way to pass the limit.
class LimitedFrames final : public thrift::transport::TTransportFactory {
 public:
  explicit LimitedFrames(int max_bytes) : max_bytes_(max_bytes) {}
  std::shared_ptr<thrift::transport::TTransport> getTransport(
      std::shared_ptr<thrift::transport::TTransport> socket) override {
    return std::make_shared<thrift::transport::TFramedTransport>(
        std::move(socket), std::make_shared<thrift::TConfiguration>(max_bytes_, max_bytes_));
  }

 private:
  const int max_bytes_;
};

/// Tells the constructor once whether the server listens.
class Listening final : public thrift::server::TServerEventHandler {
 public:
  std::future<void> result() { return promise_.get_future(); }
  void preServe() override {
    listens_ = true;
    promise_.set_value();
  }
  void ended(const std::exception& error) {
    if (listens_) {
      log.error("the Thrift server ended: {}", error.what());
    } else {
      promise_.set_exception(std::current_exception());
    }
  }

 private:
  std::promise<void> promise_;
  bool listens_ = false;  ///< of the thread that serves
};

}  // namespace

void SiteService::check_address(const std::string& host) {
  in_addr address{};
  const bool is_loopback = host == "localhost" || host == "::1" ||
                           (inet_pton(AF_INET, host.c_str(), &address) == 1 && (ntohl(address.s_addr) >> 24) == 127);
  if (is_loopback) return;
  throw config::Error(
      fmt::format("the Thrift service cannot listen on {}: it has no TLS and no token yet, so whoever reaches it could "
                  "run drivers; use a loopback address (127.0.0.1)",
                  host));
}

struct SiteService::Impl {
  std::shared_ptr<thrift::transport::TServerSocket> socket;
  std::unique_ptr<thrift::server::TThreadedServer> server;
  std::jthread thread;
};

SiteService::SiteService(Options options, Gateway& gateway, discovery::Registry& registry, discovery::Paths paths)
    : impl_(std::make_unique<Impl>()) {
  check_address(options.host);
  // The library would print to stderr by itself, past the log.
  thrift::GlobalOutput.setOutputFunction([](const char* text) { log.debug("{}", text); });
  auto handler =
      std::make_shared<SiteHandler>(options.outcome_limit, options.log_folder, gateway, registry, std::move(paths));
  impl_->socket = std::make_shared<thrift::transport::TServerSocket>(options.host, options.port);
  impl_->socket->setSendTimeout(send_limit_ms);
  impl_->socket->setKeepAlive(true);
  impl_->server = std::make_unique<thrift::server::TThreadedServer>(
      std::make_shared<wire::TSensorSiteServiceProcessor>(std::move(handler)), impl_->socket,
      std::make_shared<LimitedFrames>(options.max_message_bytes),
      std::make_shared<thrift::protocol::TBinaryProtocolFactory>(options.max_message_bytes, options.max_items, false,
                                                                 true));
  impl_->server->setConcurrentClientLimit(options.max_connections);
  const auto listening = std::make_shared<Listening>();
  impl_->server->setServerEventHandler(listening);
  auto result = listening->result();
  impl_->thread = std::jthread([server = impl_->server.get(), listening] {
    try {
      server->serve();
    } catch (const std::exception& e) {
      listening->ended(e);
    }
  });
  try {
    result.get();
  } catch (const std::exception& e) {
    throw config::Error(fmt::format("cannot listen on {}:{}: {}; is another program using the port?", options.host,
                                    options.port, e.what()));
  }
}

SiteService::~SiteService() {
  impl_->server->stop();
  impl_->thread.join();
}

int SiteService::port() const {
  return impl_->socket->getPort();
}

}  // namespace iotcloud::gateway
