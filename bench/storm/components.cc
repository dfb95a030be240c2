// The DAGs that `./dev bench storm` runs in workers, as a component library: for Storm's workers and for ours. Plain
// Java's are in bench/peers/storm (OnWorkers.java); both do the same for each item.
#include <algorithm>
#include <atomic>
#include <bit>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <system_error>
#include <unordered_map>
#include <utility>
#include <variant>
#include <vector>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <iotcloud/topology/plugin.h>

namespace iotcloud::bench {

namespace {

using topology::BasicBolt;
using topology::BasicOutputCollector;
using topology::Config;
using topology::Fields;
using topology::MessageId;
using topology::OutputFieldsDeclarer;
using topology::Payload;
using topology::SpoutOutputCollector;
using topology::TopologyContext;
using topology::Tuple;
using topology::Values;

std::int64_t now_ns() {
  return std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
}

/// A file of numbers of 8 bytes, which the benchmark and its tasks share, whatever process and language they are of
/// (Board in bench/peers/storm_board.py). In the folder `board` the file `control` has how many items a second the
/// sources send (-1: as many as possible), and each task that counts has a file COMPONENT-TASK.
class Board {
 public:
  enum Place : std::size_t { rate = 0, emitted = 0, results = 1, failed = 2, latencies = 8 };

  Board(const Config& config, const std::string& name) {
    const auto path = std::filesystem::path(config.at("board")) / name;
    const int file = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
    constexpr std::size_t bytes = (latencies + buckets) * sizeof(std::int64_t);
    void* mapped = MAP_FAILED;
    if (file >= 0 && ::ftruncate(file, bytes) == 0)
      mapped = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    const int error = errno;
    if (file >= 0) ::close(file);
    if (mapped == MAP_FAILED) throw std::system_error(error, std::generic_category(), path.string());
    numbers_ = static_cast<std::int64_t*>(mapped);  // until the process ends
  }
  Board(const Config& config, const TopologyContext& context)
      : Board(config, context.component + "-" + std::to_string(context.task)) {}

  std::int64_t get(std::size_t place) const { return at(place).load(std::memory_order_relaxed); }
  void add(std::size_t place, std::int64_t more) { at(place).store(get(place) + more, std::memory_order_relaxed); }
  /// Counts a latency in its bucket: 32 for each doubling.
  void record(std::int64_t latency_ns) {
    const auto us = static_cast<std::uint64_t>(std::max<std::int64_t>(latency_ns, 0) / 1000);
    const int shift = std::max(0, static_cast<int>(std::bit_width(us)) - 6);
    add(latencies + std::min(32 * static_cast<std::size_t>(shift) + (us >> shift), buckets - 1), 1);
  }

 private:
  static constexpr std::size_t buckets = 704;
  std::atomic_ref<std::int64_t> at(std::size_t place) const { return std::atomic_ref(numbers_[place]); }
  std::int64_t* numbers_;
};

bool is_tracked(const Config& config) {
  return config.at("tracked") == "true";
}

/// Emits items at the rate that the benchmark sets. Tracked, it counts acked items as results, and how long after their
/// time they were acked.
class Source final : public topology::Spout {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"item"}); }
  void open(const Config& config, const TopologyContext& context, SpoutOutputCollector& collector) override {
    collector_ = &collector;
    control_.emplace(config, "control");
    own_.emplace(config, context);
    tracked_ = is_tracked(config);
    results_ = std::stoll(config.at("results"));
    size_ = static_cast<std::size_t>(std::stoull(config.at("size")));
    std::ifstream file(config.at("sentences"));
    for (std::string line; std::getline(file, line);) sentences_.push_back(line);
  }
  bool next_tuple() override {
    const std::int64_t rate = control_->get(Board::rate);
    if (rate != rate_) {
      rate_ = rate;
      due_ns_ = now_ns();
    }
    if (rate == 0) return false;
    if (rate < 0) {
      emit(count_);
      return true;
    }
    if (now_ns() < due_ns_) return false;
    emit(due_ns_);
    due_ns_ += 1'000'000'000 / rate;
    return true;
  }
  void ack(MessageId id) override {
    own_->add(Board::results, results_);
    if (rate_ > 0) own_->record(now_ns() - static_cast<std::int64_t>(id));
  }
  void fail(MessageId) override { own_->add(Board::failed, 1); }
  std::chrono::microseconds poll_period() const override { return std::chrono::microseconds(200); }

 private:
  /// \param id for an item that has a time, that time
  void emit(std::int64_t id) {
    if (tracked_) {
      collector_->emit(item(), static_cast<MessageId>(id));
    } else {
      collector_->emit(item());
    }
    ++count_;
    own_->add(Board::emitted, 1);
  }
  Values item() const {
    if (!sentences_.empty()) return Values(sentences_[static_cast<std::size_t>(count_) % sentences_.size()]);
    if (size_ == 0) return Values(count_);
    std::vector<std::byte> bytes(size_);
    bytes.front() = bytes.back() = static_cast<std::byte>(count_);
    return Values(Payload::take(std::move(bytes)));
  }

  SpoutOutputCollector* collector_ = nullptr;
  std::optional<Board> control_, own_;
  bool tracked_ = false;
  std::int64_t results_ = 1;  ///< how many an item brings
  std::size_t size_ = 0;
  std::vector<std::string> sentences_;
  std::int64_t rate_ = 0;
  std::int64_t due_ns_ = 0;
  std::int64_t count_ = 0;
};

class Pass final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"item"}); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override { collector.emit(Values(tuple.at(0))); }
};

class Split final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"word"}); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const auto& sentence = tuple.get<std::string>(0);
    std::size_t begin = 0;
    for (auto end = sentence.find(' '); end != std::string::npos; end = sentence.find(' ', begin)) {
      collector.emit(Values(sentence.substr(begin, end - begin)));
      begin = end + 1;
    }
    collector.emit(Values(sentence.substr(begin)));
  }
};

/// The last bolt. Untracked, it counts what it executed as results.
class Last : public BasicBolt {
 public:
  void prepare(const Config& config, const TopologyContext& context) override {
    counts_ = !is_tracked(config);
    own_.emplace(config, context);
  }
  void execute(const Tuple& tuple, BasicOutputCollector&) override {
    if (!take(tuple)) own_->add(Board::failed, 1);
    if (counts_) own_->add(Board::results, 1);
  }

 private:
  /// \return false: it is not what was sent.
  virtual bool take(const Tuple& tuple) = 0;
  bool counts_ = false;
  std::optional<Board> own_;
};

class Sink final : public Last {
  bool take(const Tuple& tuple) override {
    const auto* payload = std::get_if<Payload>(&tuple.at(0));
    return payload == nullptr || payload->bytes().front() == payload->bytes().back();
  }
};

class Count final : public Last {
  bool take(const Tuple& tuple) override {
    ++words_[tuple.get<std::string>(0)];
    return true;
  }
  std::unordered_map<std::string, std::int64_t> words_;
};

}  // namespace

}  // namespace iotcloud::bench

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_spout<iotcloud::bench::Source>("bench.Source");
  registry.add_bolt<iotcloud::bench::Pass>("bench.Pass");
  registry.add_bolt<iotcloud::bench::Split>("bench.Split");
  registry.add_bolt<iotcloud::bench::Sink>("bench.Sink");
  registry.add_bolt<iotcloud::bench::Count>("bench.Count");
}
