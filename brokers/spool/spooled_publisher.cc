#include <utility>

#include "iotcloud/brokers/spool/spool_queue.h"
#include <iotcloud/brokers/spool/spooled_publisher.h>

namespace iotcloud::brokers {
namespace {

class SpooledPublisher final : public Publisher {
 public:
  SpooledPublisher(Broker& broker, const Topic& topic, const PublisherOptions& options, const SpoolOptions& spool)
      : queue_(std::make_shared<spool::SpoolQueue>(topic, options, spool)) {
    queue_->open(broker);
  }
  ~SpooledPublisher() override { queue_->close(); }

  Published publish(Message message) override { return queue_->publish(std::move(message)); }
  bool drain(std::chrono::milliseconds limit) override { return queue_->drain(limit); }
  std::size_t pending() const override { return queue_->pending(); }
  std::optional<config::Clock::Instant> oldest() const override { return queue_->oldest(); }

 private:
  const std::shared_ptr<spool::SpoolQueue> queue_;
};

}  // namespace

std::unique_ptr<Publisher> make_spooled_publisher(Broker& broker, const Topic& topic, const PublisherOptions& options,
                                                  const SpoolOptions& spool) {
  return std::make_unique<SpooledPublisher>(broker, topic, options, spool);
}

}  // namespace iotcloud::brokers
