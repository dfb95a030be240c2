#include <atomic>
#include <utility>

#include <iotcloud/discovery/embedded/server.h>

namespace iotcloud::discovery::embedded {
namespace {

class EmbeddedConnection : public Connection {
 public:
  EmbeddedConnection(std::shared_ptr<Server> server, std::chrono::milliseconds timeout)
      : server_(std::move(server)), timeout_(timeout) {}
  ~EmbeddedConnection() override { server_->close_session(session_); }
  EmbeddedConnection(const EmbeddedConnection&) = delete;
  EmbeddedConnection& operator=(const EmbeddedConnection&) = delete;

  bool open(Events events) override {
    events_ = std::move(events);
    return renew();
  }
  bool renew() override {
    session_ = server_->open_session(events_, timeout_);
    return true;
  }
  std::chrono::milliseconds certain_after_disconnect(std::chrono::milliseconds timeout) const override {
    return timeout;  // a partition is noticed at once
  }

  void create(const std::string& path, const std::string& data, bool ephemeral, bool sequential, const Fence& fence,
              Done done) override {
    server_->create(session_, path, data, ephemeral, sequential, fence, done);
  }
  void set(const std::string& path, const std::string& data, std::int64_t expected_version, const Fence& fence,
           Done done) override {
    server_->set(session_, path, data, expected_version, fence, done);
  }
  void remove(const std::string& path, std::int64_t expected_version, const Fence& fence, Done done) override {
    server_->remove(session_, path, expected_version, fence, done);
  }
  void get(const std::string& path, bool watch, Done done) override { server_->get(session_, path, watch, done); }
  void children(const std::string& path, bool watch, Done done) override {
    server_->children(session_, path, watch, done);
  }

 private:
  const std::shared_ptr<Server> server_;
  const std::chrono::milliseconds timeout_;
  Events events_;
  std::atomic<std::int64_t> session_{0};
};

}  // namespace

std::unique_ptr<Connection> make_connection(std::shared_ptr<Server> server, std::chrono::milliseconds session_timeout) {
  return std::make_unique<EmbeddedConnection>(std::move(server), session_timeout);
}

}  // namespace iotcloud::discovery::embedded
