#include <atomic>
#include <utility>

#include <iotcloud/discovery/embedded/server.h>

namespace iotcloud::discovery::embedded {
namespace {

class EmbeddedConnection : public RegistryConnection {
 public:
  EmbeddedConnection(std::shared_ptr<RegistryServer> server, std::chrono::milliseconds timeout)
      : server_(std::move(server)), timeout_(timeout) {}
  ~EmbeddedConnection() override {
    ask_no_more();
    server_->close_session(session_);
  }
  EmbeddedConnection(const EmbeddedConnection&) = delete;
  EmbeddedConnection& operator=(const EmbeddedConnection&) = delete;

  bool open(Events events) override {
    events_ = std::move(events);
    return renew();
  }
  bool renew() override {
    server_->close_session(session_);  // the server may know it still, if it refuses it
    session_ = server_->open_session(events_, timeout_);
    return true;
  }
  bool ask_for_new(std::function<void()> serves) override {
    ask_no_more();
    question_ = server_->ask_for_new(std::move(serves));
    return true;
  }
  void ask_no_more() override { server_->ask_no_more(std::exchange(question_, 0)); }
  std::chrono::milliseconds certain_after_disconnect(std::chrono::milliseconds timeout) const override {
    return timeout;  // a partition is noticed at once
  }
  /// As ZooKeeper's, so that a partition which is shorter than the time-out costs no session.
  std::chrono::milliseconds longest_attempt(std::chrono::milliseconds timeout) const override {
    return timeout * 2 / 3;
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
  const std::shared_ptr<RegistryServer> server_;
  const std::chrono::milliseconds timeout_;
  Events events_;
  std::atomic<std::int64_t> session_{0};
  std::int64_t question_ = 0;  ///< 0: none is open
};

}  // namespace

std::unique_ptr<RegistryConnection> make_connection(std::shared_ptr<RegistryServer> server,
                                                    std::chrono::milliseconds session_timeout) {
  return std::make_unique<EmbeddedConnection>(std::move(server), session_timeout);
}

}  // namespace iotcloud::discovery::embedded
