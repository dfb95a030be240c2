#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include <iotcloud/brokers/message.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/output_collector.h>

namespace iotcloud::topology {

/// The way of one message through this worker. Times are nanoseconds of the topology's clock; 0: not yet.
struct MessageWay {
  /// What one task did with one tuple of the message.
  struct Step {
    std::string component;
    int task = 0;
    std::string from, stream;  ///< the component that emitted the tuple, and the stream
    std::int64_t emitted_ns = 0;
    std::int64_t begin_ns = 0, end_ns = 0;  ///< of execute()
    std::int64_t settled_ns = 0;            ///< acked or failed; a bolt that sends acks when the broker has confirmed
    bool acked = false;
  };
  std::string driver, gateway;  ///< of the message
  std::int64_t time_ms = 0;     ///< the message's own time
  std::string topic;
  std::string spout;           ///< empty: none has taken it
  std::int64_t came_ns = 0;    ///< the broker's client handed it over
  std::int64_t taken_ns = 0;   ///< the spout emitted it, the last time
  std::int64_t done_ns = 0;    ///< its whole tree was acked, or it was given up
  std::string outcome;         ///< "acked", "given up"; "not followed": the spout's tuples are not tracked
  int tries = 0;               ///< how often it was emitted
  std::vector<Step> steps;     ///< in the order in which they began, most_steps at most
  std::size_t more_steps = 0;  ///< steps that are not kept
  static constexpr std::size_t most_steps = 64;
};

/// Writes the way of one message down. Thread safe.
class MessageTrace final : public TupleTrace {
 public:
  MessageTrace(const brokers::Message& message, std::string driver, std::string topic, std::int64_t now_ns);

  void emitted(const TopologyContext& task, const detail::TupleData& tuple, std::int64_t at_ns) noexcept override;
  void executed(const TopologyContext& task, const detail::TupleData& tuple, std::int64_t begin_ns,
                std::int64_t end_ns) noexcept override;
  void settled(const TopologyContext& task, const detail::TupleData& tuple, std::int64_t at_ns,
               bool acked) noexcept override;

  /// Its spout is about to emit it. \return false: it did before, and `again` is false
  bool take(const std::string& spout, std::int64_t now_ns, bool again);
  void done(config::Clock::Instant now, const std::string& outcome);
  MessageWay way() const;
  bool is_done() const;

 private:
  /// A step, and the tuple that it is of.
  struct Open {
    const void* tuple = nullptr;
    int task = 0;
    std::size_t place = 0;
  };
  MessageWay::Step* step_of(const TopologyContext& task, const detail::TupleData& tuple) IOTCLOUD_REQUIRES(mutex_);
  void close(const TopologyContext& task, const detail::TupleData& tuple) IOTCLOUD_REQUIRES(mutex_);

  mutable config::Mutex mutex_;
  MessageWay way_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<const void*, std::int64_t> emitted_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by tuple: when
  std::vector<Open> open_ IOTCLOUD_GUARDED_BY(mutex_);                       ///< steps that are not settled
};

/// Follows messages of driver instances that people ask about: of each topic the first in each so many milliseconds of
/// the messages' own time, so that driver hosts and workers choose the same ones without talking to each other. Nothing
/// is followed when nobody asks for `patience`. Thread safe.
class MessageTraces {
 public:
  static constexpr std::size_t most_questions = 8;                          ///< that are open at the same time
  static constexpr std::size_t most_kept = 64;                              ///< messages that one question keeps
  static constexpr std::size_t most_topics = 32;                            ///< of one question's driver instance
  static constexpr std::size_t most_followed = most_questions * most_kept;  ///< messages at the same time
  static constexpr std::chrono::seconds patience{5};
  static constexpr std::chrono::seconds longest_way{2};  ///< an unfinished way is told after that

  /// \param clock the topology's; outlives this
  explicit MessageTraces(const config::Clock& clock) : clock_(clock) {}

  /// Sets what is told when the first question comes, and when the last has ended. Call it before the topology starts.
  void on_change(std::function<void(bool any)> call) { on_change_ = std::move(call); }
  /// Whether came() and take() are to be called: one read of an atomic.
  bool any() const { return any_.load(std::memory_order_relaxed); }
  /// The broker's client has handed over a message. \param sender the instance whose topic it is, for a message that
  /// does not name its own
  void came(const brokers::Message& message, const std::string& topic, const std::string& sender);
  /// A spout is about to emit the message. \param again it did before. \return null: it is not followed
  std::shared_ptr<MessageTrace> take(const brokers::Message& message, const std::string& topic,
                                     const std::string& spout, bool again);

  struct Question {
    std::string id;      ///< names the question; the first poll with it opens it
    std::string driver;  ///< the instance whose messages are followed
    std::int64_t every_ms = 200;
  };
  struct Answer {
    std::vector<MessageWay> ways;  ///< finished, or older than longest_way
    std::size_t missed = 0;        ///< ways that were dropped because they were too many
  };
  /// \throws std::invalid_argument, whose text says what is possible
  Answer poll(const Question& question);
  void end(const std::string& id);

 private:
  using Key = std::tuple<std::string, std::string, std::int64_t>;  ///< topic, instance, the message's time
  struct Kept {
    std::shared_ptr<MessageTrace> trace;
    config::Clock::Instant since;
  };
  struct Open {
    Question question;
    config::Clock::Instant asked;
    std::map<std::string, std::int64_t> slots;  ///< by topic: of the message that was chosen last
    std::deque<Kept> kept;
    std::size_t missed = 0;
  };
  void expire(config::Clock::Instant now) IOTCLOUD_REQUIRES(mutex_);
  void show() IOTCLOUD_REQUIRES(mutex_);

  const config::Clock& clock_;
  std::function<void(bool)> on_change_;
  std::atomic<bool> any_{false};
  config::Mutex mutex_;
  std::map<std::string, Open> open_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<Key, Kept> followed_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology
