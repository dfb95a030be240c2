#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/brokers/message.h>
#include <iotcloud/config/metrics.h>

/// The work of every engine: the same items at the same times, counted and timed in the same way.
namespace iotcloud::bench {

enum class Dag {
  chain,    ///< source -> pass -> sink, a number
  words,    ///< source -> split (2) -> by word -> count (2), sentences of ten words
  fan,      ///< source -> pass (4, in turn) -> sink, a number
  payload,  ///< like chain, 60 KB
};

struct Options {
  std::string dag_name = "chain";
  Dag dag = Dag::chain;
  bool tracked = false;
  bool numbered = false;  ///< each word has its item's number, as it always has with a rate and on the rings
  bool births = false;    ///< tuples record their birth; iotcloud_engine.cc only
  double rate = 0;        ///< results a second; 0: as many as possible
  double most = 0;  ///< results a second that the engine could do at most; 0: as many as it can; calls_engine.cc only
  double warm_up = 0.5, seconds = 1.5;
  unsigned threads = 0;  ///< 0: the engine's own choice
  int sources = 1;       ///< tasks of the source: 1, or 2 if the rate is 0; only iotcloud_engine.cc has two
};
inline constexpr std::uint64_t max_pending = 4096;  ///< most tracked items under way

constexpr std::uint64_t results_of_item(Dag dag) {
  return dag == Dag::words ? 10 : 1;
}
/// Hand-overs of tuples from task to task for one result.
constexpr double hops_of_result(Dag dag) {
  return dag == Dag::words ? 1.1 : 2;
}

/// The source's view: which item is due. One thread at a time uses it, except where a comment says otherwise. Without
/// pacing several may call due().
class Feed {
 public:
  explicit Feed(const Options& options);
  /// Whether the next item is due now. \return false if none is due, or the feed is stopped.
  bool due() {
    if (sent_.load(std::memory_order_relaxed) < due_) return !stopped();
    return look();
  }
  /// Takes the item that due() found: 0, 1, 2, ...
  std::uint64_t take() {
    const std::uint64_t n = sent_.load(std::memory_order_relaxed);
    sent_.store(n + 1, std::memory_order_relaxed);
    return n;
  }
  /// The same, by several threads at a time.
  std::uint64_t take_among_others() { return sent_.fetch_add(1, std::memory_order_relaxed); }
  /// The time at which item `n` should be sent. Any thread, after start().
  std::int64_t intended_ns(std::uint64_t n) const {
    return start_ns_ + static_cast<std::int64_t>(static_cast<double>(n) * interval_ns_);
  }
  bool paced() const { return interval_ns_ > 0; }
  /// Time between items; 0 if not paced.
  double interval_ns() const { return interval_ns_; }
  void start();                     ///< before the first due()
  void stop() { stopped_ = true; }  ///< any thread
  bool stopped() const { return stopped_.load(std::memory_order_relaxed); }
  std::uint64_t sent() const { return sent_.load(std::memory_order_relaxed); }  ///< any thread

 private:
  bool look();
  const double interval_ns_;
  std::int64_t start_ns_ = 0;
  std::uint64_t due_ = 0;
  std::atomic<std::uint64_t> sent_{0};
  std::atomic<bool> stopped_{false};
};

/// Counts and times the items that arrive at one task of the last component. One thread at a time writes, any thread
/// reads.
class alignas(64) Arrivals {
 public:
  /// \param results how many results the item brought.
  void arrived(const Feed& feed, std::uint64_t n, std::uint64_t results = 1) {
    count_.store(count_.load(std::memory_order_relaxed) + results, std::memory_order_relaxed);
    if (timing_ && (n & sample_mask_) == 0) record(feed, n);
  }
  /// Counts a result that does not know its item, so it is not timed.
  void arrived() { count_.store(count_.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed); }
  std::uint64_t count() const { return count_.load(std::memory_order_relaxed); }

  /// Times one of `every` items (a power of two) from now on. Call it before the engine starts.
  void time(std::uint64_t every) { timing_ = true, sample_mask_ = every - 1; }
  /// Records only items from `first` on. Any thread.
  void begin_recording(std::uint64_t first) { first_recorded_.store(first, std::memory_order_relaxed); }
  /// Latency counts from the due time, service from the time when the source's thread woke up for the item.
  config::Histogram latency, service;
  /// When the thread that brings items was last woken. Written by that thread.
  std::atomic<std::int64_t>* brought_ns = nullptr;

 private:
  void record(const Feed& feed, std::uint64_t n);
  std::atomic<std::uint64_t> count_{0};
  bool timing_ = false;
  std::uint64_t sample_mask_ = 0;
  std::atomic<std::uint64_t> first_recorded_{~std::uint64_t{0}};
};

/// Sentences of ten words, of 1000 different ones, frequent ones more often.
class Sentences {
 public:
  Sentences();
  const std::string& operator[](std::uint64_t n) const { return all_[n & (all_.size() - 1)]; }
  std::size_t size() const { return all_.size(); }

 private:
  std::vector<std::string> all_;
};

/// Calls `each(std::string_view)` for each word.
template <typename Each>
void split(std::string_view sentence, Each&& each) {
  while (!sentence.empty()) {
    const std::size_t end = sentence.find(' ');
    each(sentence.substr(0, end));
    if (end == std::string_view::npos) return;
    sentence.remove_prefix(end + 1);
  }
}

using WordCounts = std::unordered_map<std::string, std::uint64_t>;

/// A few payloads of 60 KB, sent in turn; a receiver checks that it got the very same memory.
class Payloads {
 public:
  Payloads();
  const brokers::Payload& operator[](std::uint64_t n) const { return all_[n % all_.size()]; }
  bool is_same(std::uint64_t n, const brokers::Payload& arrived) const { return arrived.data() == (*this)[n].data(); }

 private:
  std::vector<brokers::Payload> all_;
};

/// The objects that the engine's components share in one measurement.
struct Workload {
  explicit Workload(const Options& o) : options(o), feed(o) {}
  const Options options;
  Feed feed;
  Arrivals arrivals[2];  ///< of the last tasks; of the source if items are acked there
  Sentences sentences;
  Payloads payloads;
  std::atomic<std::uint64_t> wrong{0};  ///< failed, or received with another payload
};

/// Runs a DAG.
class Engine {
 public:
  virtual ~Engine() = default;
  /// Sends the due items, on this thread or by waking its own threads. Returns when none is due, or when the engine's
  /// own threads continue. Without pacing it returns when the feed is stopped at the latest. With pacing it is called
  /// once more after that.
  virtual void pump() = 0;
  /// Called once, after the feed is stopped and everything has arrived.
  virtual void stop() = 0;
};

}  // namespace iotcloud::bench
