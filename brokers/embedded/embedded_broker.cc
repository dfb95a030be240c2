#include "iotcloud/brokers/embedded/embedded_broker.h"

#include <algorithm>
#include <utility>

#include "iotcloud/brokers/embedded/connection.h"
#include "iotcloud/brokers/letter_box.h"
#include "iotcloud/brokers/limits.h"
#include <iotcloud/brokers/embedded/server.h>

namespace iotcloud::brokers::embedded {
namespace {

class EmbeddedPublisher final : public Publisher {
 public:
  EmbeddedPublisher(std::shared_ptr<EmbeddedConnection> connection, const Topic& topic, const PublisherOptions& options)
      : connection_(std::move(connection)), server_(*connection_->server) {
    publisher_->topic = topic;
    publisher_->options = options;
    publisher_->options.capacity = std::max<std::size_t>(options.capacity, 1);
    publisher_->connection = connection_.get();
    const config::MutexLock lock(server_.mutex);
    publisher_->route = server_.route(topic.name);
    connection_->publishers.push_back(publisher_.get());
    if (options.own_queue) server_.make_own_queue(topic, connection_->clock.now());
  }

  ~EmbeddedPublisher() override {
    WakeList wake;
    const config::MutexLock lock(server_.mutex);
    publisher_->closed = true;
    publisher_->wants_writable = publisher_->writable_due = false;
    for (const auto& waiting : publisher_->waiting) {
      server_.settle(*publisher_, waiting.number, Outcome::unknown, reason::closed, wake);
    }
    publisher_->waiting.clear();
    std::erase(publisher_->route->waiting, publisher_.get());
    if (!connection_->on_own_thread() || !publisher_->reporting) connection_->report(publisher_);
    std::erase(connection_->publishers, publisher_.get());
    std::erase(connection_->timed, publisher_.get());
  }

  Published publish(Message message) override { return publish_again(std::move(message), {}); }

  Published publish_again(Message message, const Past& past) override {
    WakeList wake;
    const config::MutexLock lock(server_.mutex);
    if (publisher_->closed) return {PublishStatus::closed};
    const Instant now = connection_->clock.now();
    server_.expire(*publisher_, now, wake);
    if (const char* why = refusal(message)) {
      accept();
      server_.settle(*publisher_, publisher_->last_number, Outcome::refused, why, wake);
      return {PublishStatus::accepted, publisher_->last_number};
    }
    ServerPublisher::Waiting waiting{std::move(message), publisher_->last_number + 1, now - past.age,
                                     past.possibly_sent};
    if (publisher_->waiting.empty() && server_.deliver(*publisher_->route, waiting, publisher_->options, now, wake)) {
      accept();
      server_.settle(*publisher_, publisher_->last_number, Outcome::confirmed, "", wake);
      return {PublishStatus::accepted, publisher_->last_number};
    }
    return wait(std::move(waiting), wake);
  }

  bool drain(std::chrono::milliseconds limit) override {
    const Instant end = connection_->clock.now() + limit;
    const config::MutexLock lock(server_.mutex);
    connection_->assert_held();
    while (publisher_->pending > 0) {
      if (!publisher_->events.empty() && !publisher_->reporting) {
        connection_->report(publisher_);
      } else if (connection_->changed.wait_until(server_.mutex, connection_->clock, end) == std::cv_status::timeout) {
        return publisher_->pending == 0;
      }
    }
    return true;
  }

  std::size_t pending() const override {
    const config::MutexLock lock(server_.mutex);
    return publisher_->pending;
  }

  std::optional<config::Clock::Instant> oldest() const override {
    const config::MutexLock lock(server_.mutex);
    if (publisher_->waiting.empty()) return std::nullopt;
    return publisher_->waiting.front().accepted;
  }

 private:
  void accept() IOTCLOUD_REQUIRES(server_.mutex) {
    ++publisher_->last_number;
    ++publisher_->pending;
  }

  /// Keeps a message that the server cannot take now, or refuses or replaces one, as `when_full` says.
  Published wait(ServerPublisher::Waiting waiting, WakeList& wake) IOTCLOUD_REQUIRES(server_.mutex) {
    if (publisher_->waiting.size() >= publisher_->options.capacity) {
      if (publisher_->options.when_full == WhenFull::block) {
        publisher_->wants_writable = true;
        return {PublishStatus::would_block};
      }
      const bool unread = server_.running() && publisher_->route->queues.empty();
      server_.settle(*publisher_, publisher_->waiting.front().number, Outcome::dropped,
                     unread ? reason::no_reader : reason::superseded, wake);
      publisher_->waiting.pop_front();
    }
    if (publisher_->waiting.empty()) {
      auto& all = publisher_->route->waiting;
      if (std::find(all.begin(), all.end(), publisher_.get()) == all.end()) all.push_back(publisher_.get());
      if (publisher_->options.deadline.count() > 0 && !publisher_->timed) {
        publisher_->timed = true;
        connection_->assert_held();
        connection_->timed.push_back(publisher_.get());
        wake.add(*connection_);  // so that its thread wakes up for the deadline
      }
    }
    accept();
    publisher_->waiting.push_back(std::move(waiting));
    return {PublishStatus::accepted, publisher_->last_number};
  }

  const std::shared_ptr<EmbeddedConnection> connection_;
  ServerState& server_;
  const std::shared_ptr<ServerPublisher> publisher_ = std::make_shared<ServerPublisher>();
};

class EmbeddedSubscription final : public Subscription {
 public:
  EmbeddedSubscription(std::shared_ptr<EmbeddedConnection> connection, const Topic& topic,
                       const SubscriptionOptions& options, Handler handler)
      : connection_(std::move(connection)),
        server_(*connection_->server),
        reader_(std::make_shared<HandlerConsumer>(connection_->server, connection_, std::move(handler))) {
    reader_->topic = topic;
    reader_->options = options;
    reader_->connection = connection_.get();
    WakeList wake;
    const config::MutexLock lock(server_.mutex);
    connection_->consumers.push_back(reader_);
    server_.attach(reader_, connection_->clock.now(), wake);
  }

  ~EmbeddedSubscription() override {
    {
      WakeList wake;
      const config::MutexLock lock(server_.mutex);
      reader_->closed = true;
      server_.detach(*reader_, connection_->clock.now(), wake);
      std::erase(connection_->consumers, reader_);
    }
    const config::MutexLock lock(server_.mutex);
    if (!connection_->on_own_thread()) {
      while (reader_->running) connection_->changed.wait(server_.mutex);
    }
  }

  void pause() override {
    const config::MutexLock lock(server_.mutex);
    reader_->paused = true;
  }

  void resume() override {
    WakeList wake;
    const config::MutexLock lock(server_.mutex);
    reader_->paused = false;
    server_.make_ready(reader_, wake);
  }

  bool raise_prefetch(std::uint16_t prefetch) override {
    WakeList wake;
    const config::MutexLock lock(server_.mutex);
    if (prefetch > reader_->options.prefetch_limit) return false;
    reader_->options.prefetch = std::max(reader_->options.prefetch, prefetch);
    server_.make_ready(reader_, wake);
    return true;
  }

  bool active() const override {
    const config::MutexLock lock(server_.mutex);
    return reader_->active;
  }

  std::optional<std::uint64_t> backlog() override {
    const config::MutexLock lock(server_.mutex);
    if (!reader_->queue) return std::nullopt;
    return reader_->queue->size();
  }

 private:
  const std::shared_ptr<EmbeddedConnection> connection_;
  ServerState& server_;
  const std::shared_ptr<HandlerConsumer> reader_;
};

class EmbeddedBroker final : public Broker {
 public:
  EmbeddedBroker(const BrokerOptions& options, const std::string& name)
      : url_(options.urls.front()),
        connection_(std::make_shared<EmbeddedConnection>(
            Server::named(name).state(), options.clock != nullptr ? *options.clock : config::system_clock(),
            Meters(options.metrics, "embedded"))) {
    connection_->open();
  }
  ~EmbeddedBroker() override { connection_->close(); }

  std::unique_ptr<Publisher> publisher(const Topic& topic, const PublisherOptions& options) override {
    return std::make_unique<EmbeddedPublisher>(connection_, topic, options);
  }
  std::unique_ptr<Subscription> subscribe(const Topic& topic, const SubscriptionOptions& options,
                                          Handler handler) override {
    return std::make_unique<EmbeddedSubscription>(connection_, topic, options,
                                                  dead_letters_.guard(topic, options, std::move(handler)));
  }
  void remove_queue(const Topic& topic, const std::string& group) override {
    const config::MutexLock lock(connection_->server->mutex);
    connection_->server->remove_unneeded(queue_name(topic.name, group));
  }
  ConnectionState state() const override {
    const config::MutexLock lock(connection_->server->mutex);
    return connection_->server->running() ? ConnectionState::connected : ConnectionState::connecting;
  }
  const std::string& url() const override { return url_; }

 private:
  const std::string url_;
  const std::shared_ptr<EmbeddedConnection> connection_;
  DeadLetters dead_letters_{*this};  ///< destroyed before the connection, with its publishers
};

}  // namespace

std::unique_ptr<Broker> make_embedded_broker(const BrokerOptions& options, const std::vector<BrokerUrl>& urls) {
  return std::make_unique<EmbeddedBroker>(options, urls.front().host);
}

}  // namespace iotcloud::brokers::embedded
