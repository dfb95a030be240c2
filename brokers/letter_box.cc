#include "iotcloud/brokers/letter_box.h"

#include <atomic>
#include <limits>
#include <utility>

#include <iotcloud/brokers/logger.h>

namespace iotcloud::brokers {
LetterBox::LetterBox(Broker& broker, std::string topic, std::function<void(bool)> moved)
    : topic_(std::move(topic)), moved_(std::move(moved)) {
  PublisherOptions options;
  options.own_queue = true;
  // each letter holds an unsettled message, whose number prefetch limits
  options.capacity = std::numeric_limits<int>::max();
  options.on_outcome = [this](std::uint64_t number, Outcome outcome, const std::string& reason) {
    on_outcome(number, outcome, reason);
  };
  publisher_ = broker.publisher(Topic{"", topic_, true}, options);
}

void LetterBox::send(Message letter, Delivery original, std::shared_ptr<const void> owner) {
  const config::MutexLock lock(mutex_);  // so that an outcome waits until its number is stored
  const Published published = publisher_->publish(std::move(letter));
  if (published != PublishStatus::accepted) return;  // the original stays in the broker
  under_way_.emplace(published.number, UnderWay{std::move(owner), std::move(original)});
}

void LetterBox::on_outcome(std::uint64_t number, Outcome outcome, const std::string& reason) {
  decltype(under_way_)::node_type node;
  {
    const config::MutexLock lock(mutex_);
    node = under_way_.extract(number);
  }
  if (node.empty()) return;
  Delivery& original = node.mapped().original;
  if (outcome == Outcome::confirmed) {
    moved_(true);
    original.settle(Settlement::accept);
  } else if (outcome == Outcome::refused) {
    moved_(false);
    logger.error("the broker refused a dead letter for {}: {}; the message is rejected", topic_, reason);
    original.settle(Settlement::reject);
  }
  // Otherwise the outcome is unknown, and the message goes back to its queue.
}

/// Settles a delivery in place of its handler.
class DeadLetters::Guard final : public Settler {
 public:
  /// A subscription's topic and options.
  struct Subscribed {
    Topic topic;
    SubscriptionOptions options;
  };
  /// \param subscription shared by all its deliveries
  Guard(DeadLetters& owner, std::shared_ptr<const Subscribed> subscription, Delivery original)
      : owner_(owner), subscription_(std::move(subscription)), original_(std::move(original)) {}

  void settle(std::uint64_t, Settlement settlement) noexcept override {
    const auto& [topic, options] = *subscription_;
    if (settled_.exchange(true)) return;
    const bool given_up =
        settlement == Settlement::reject ||
        (settlement == Settlement::retry && options.max_tries > 0 && original_.tries >= options.max_tries);
    if (!given_up) {
      original_.settle(settlement);
      return;
    }
    if (options.dead_letter.empty()) {
      original_.settle(Settlement::reject);
      return;
    }
    Message letter = original_.message;
    letter.properties.set("dead-letter-reason", settlement == Settlement::reject ? "rejected" : "retried too often");
    letter.properties.set("dead-letter-tries", std::to_string(original_.tries));
    letter.properties.set("dead-letter-topic", topic.name);
    letter.properties.set("dead-letter-group", options.group);
    owner_.box(options.dead_letter).send(std::move(letter), std::move(original_));
  }

 private:
  DeadLetters& owner_;
  const std::shared_ptr<const Subscribed> subscription_;
  std::atomic<bool> settled_{false};
  Delivery original_;
};

Handler DeadLetters::guard(const Topic& topic, const SubscriptionOptions& options, Handler handler) {
  if (options.max_tries == 0 && options.dead_letter.empty()) return handler;
  auto subscription = std::make_shared<const Guard::Subscribed>(Guard::Subscribed{topic, options});
  return [this, subscription = std::move(subscription), handler = std::move(handler)](Delivery original) {
    Message message = original.message;
    const bool redelivered = original.redelivered;
    const std::uint32_t tries = original.tries;
    Delivery guarded(std::move(message), redelivered, std::make_shared<Guard>(*this, subscription, std::move(original)),
                     0);
    guarded.tries = tries;
    handler(std::move(guarded));
  };
}

void DeadLetters::drain(const std::string& dead_letter, std::chrono::milliseconds limit) {
  LetterBox* box = nullptr;
  {
    const config::MutexLock lock(mutex_);
    if (const auto found = boxes_.find(dead_letter); found != boxes_.end()) box = found->second.get();
  }
  if (box != nullptr) box->drain(limit);
}

LetterBox& DeadLetters::box(const std::string& topic) {
  const config::MutexLock lock(mutex_);
  auto& box = boxes_[topic];
  if (!box) box = std::make_unique<LetterBox>(broker_, topic, [](bool) {});
  return *box;
}

}  // namespace iotcloud::brokers
