// The DAGs by hand: a thread for each task, a ring between two tasks, typed items and nothing else. This is the limit
// for a runtime that hands work from thread to thread.
#include <array>
#include <functional>
#include <optional>
#include <vector>

#include <iotcloud/bench/runtime/measure.h>
#include <iotcloud/bench/runtime/ring.h>

namespace iotcloud::bench {

namespace {

struct Number {
  std::uint64_t n = 0;
};
struct Text {
  std::string text;
  std::uint64_t n = 0;
};
struct Block {
  brokers::Payload payload;
  std::uint64_t n = 0;
};

/// Threads, one for each task, which end when stopped.
class Stages {
 public:
  ~Stages() { stop(); }
  /// \param take works on a batch and returns its size.
  /// \param ready whether there is a batch to take.
  /// \param idle called before the thread waits.
  template <typename Take, typename Ready, typename Idle>
  void add(Doorbell& bell, Take take, Ready ready, Idle idle) {
    bells_.push_back(&bell);
    threads_.emplace_back([=, this, &bell] {
      while (true) {
        if (take() > 0) continue;
        idle();
        bell.wait([&] { return ready() || over_.load(std::memory_order_acquire); });
        if (!ready() && over_.load()) return;
      }
    });
  }
  void stop() {
    over_.store(true);
    for (Doorbell* bell : bells_) bell->ring();
    threads_.clear();
  }

 private:
  std::atomic<bool> over_{false};
  std::vector<Doorbell*> bells_;
  std::vector<std::jthread> threads_;
};

/// The source's side, on the thread that pumps. Tracked: the last tasks return the number of every result, and at most
/// max_pending items are under way.
class RingEngine : public Engine {
 public:
  explicit RingEngine(Workload& work) : work_(work) {}
  void pump() override {
    while (true) {
      take_acks();
      std::size_t sent = 0;
      while (sent < Ring<Number>::batch && may_send() && work_.feed.due()) {
        send(work_.feed.take());
        ++sent;
      }
      if (sent > 0 && !work_.feed.paced()) continue;
      flush();
      if (work_.feed.stopped()) break;
      if (sent > 0) continue;
      if (may_send()) return;  // paced, and no item is due
      source_bell_.wait([this] { return !acks_[0].empty() || !acks_[1].empty(); });
    }
    while (work_.options.tracked && acked_ < work_.feed.sent() * acks_of_item_) {
      source_bell_.wait([this] { return !acks_[0].empty() || !acks_[1].empty(); });
      take_acks();
    }
  }
  void stop() override { stages_.stop(); }

 protected:
  virtual void send(std::uint64_t n) = 0;
  virtual void flush() = 0;
  /// Item `n` has arrived in the last task of that index.
  void arrived(std::size_t task, std::uint64_t n) {
    work_.arrivals[task].arrived(work_.feed, n);
    if (work_.options.tracked) acks_[task].put({n});
  }
  void idle(std::size_t task) { acks_[task].flush(); }

  Workload& work_;
  Doorbell source_bell_;
  std::uint64_t acks_of_item_ = 1;

 private:
  bool may_send() const {
    return !work_.options.tracked || work_.feed.sent() * acks_of_item_ - acked_ < max_pending * acks_of_item_;
  }
  void take_acks() {
    for (AckRing& ring : acks_) {
      acked_ += ring.take([](Number) {});
    }
  }
  /// Large enough for all items under way, so that the last task never waits for the source, which may wait for it.
  using AckRing = Ring<Number, std::size_t{16} * max_pending>;
  std::array<Doorbell, 2> ack_room_;
  std::array<AckRing, 2> acks_{AckRing{source_bell_, ack_room_[0]}, AckRing{source_bell_, ack_room_[1]}};
  std::uint64_t acked_ = 0;

 protected:
  Stages stages_;
};

/// source -> `Width` passes -> sink.
template <typename Item, std::size_t Width>
class ChainEngine final : public RingEngine {
 public:
  explicit ChainEngine(Workload& work) : RingEngine(work) {
    for (std::size_t i = 0; i < Width; ++i) {
      in_.push_back(std::make_unique<Ring<Item>>(pass_bells_[i], source_bell_));
      out_.push_back(std::make_unique<Ring<Item>>(sink_bell_, pass_bells_[i]));
    }
    for (std::size_t i = 0; i < Width; ++i) {
      stages_.add(
          pass_bells_[i], [this, i] { return in_[i]->take([&](Item&& item) { out_[i]->put(std::move(item)); }); },
          [this, i] { return !in_[i]->empty(); }, [this, i] { out_[i]->flush(); });
    }
    stages_.add(
        sink_bell_, [this] { return take_all(); },
        [this] {
          for (const auto& ring : out_) {
            if (!ring->empty()) return true;
          }
          return false;
        },
        [this] { idle(0); });
  }
  ~ChainEngine() override { stages_.stop(); }

 private:
  void send(std::uint64_t n) override {
    if constexpr (std::is_same_v<Item, Block>) {
      in_[n % Width]->put({work_.payloads[n], n});
    } else {
      in_[n % Width]->put({n});
    }
  }
  void flush() override {
    for (const auto& ring : in_) ring->flush();
  }
  std::size_t take_all() {
    std::size_t count = 0;
    for (const auto& ring : out_) {
      count += ring->take([this](Item&& item) {
        if constexpr (std::is_same_v<Item, Block>) {
          if (!work_.payloads.is_same(item.n, item.payload)) ++work_.wrong;
          item.payload = {};
        }
        arrived(0, item.n);
      });
    }
    return count;
  }
  std::array<Doorbell, Width> pass_bells_;
  Doorbell sink_bell_;
  std::vector<std::unique_ptr<Ring<Item>>> in_, out_;
};

/// source -> split (2) -> count (2), a ring from each split to each count.
class WordsEngine final : public RingEngine {
 public:
  explicit WordsEngine(Workload& work) : RingEngine(work) {
    acks_of_item_ = results_of_item(Dag::words);
    for (std::size_t s = 0; s < 2; ++s) {
      in_.push_back(std::make_unique<Ring<Text>>(split_bells_[s], source_bell_));
      for (std::size_t c = 0; c < 2; ++c) words_[s][c] = std::make_unique<Ring<Text>>(count_bells_[c], split_bells_[s]);
    }
    for (std::size_t s = 0; s < 2; ++s) {
      stages_.add(
          split_bells_[s], [this, s] { return in_[s]->take([&](Text&& sentence) { split_to(s, sentence); }); },
          [this, s] { return !in_[s]->empty(); },
          [this, s] {
            for (const auto& ring : words_[s]) ring->flush();
          });
    }
    for (std::size_t c = 0; c < 2; ++c) {
      stages_.add(
          count_bells_[c], [this, c] { return count(c); },
          [this, c] { return !words_[0][c]->empty() || !words_[1][c]->empty(); }, [this, c] { idle(c); });
    }
  }
  ~WordsEngine() override { stages_.stop(); }

 private:
  void send(std::uint64_t n) override { in_[n % 2]->put({work_.sentences[n], n}); }
  void flush() override {
    for (const auto& ring : in_) ring->flush();
  }
  void split_to(std::size_t s, const Text& sentence) {
    split(sentence.text, [&](std::string_view word) {
      Ring<Text>& ring = *words_[s][std::hash<std::string_view>{}(word) % 2];
      ring.put({std::string(word), sentence.n});
    });
  }
  std::size_t count(std::size_t c) {
    std::size_t taken = 0;
    for (std::size_t s = 0; s < 2; ++s) {
      taken += words_[s][c]->take([&](Text&& word) {
        ++counts_[c][word.text];
        arrived(c, word.n);
      });
    }
    return taken;
  }
  std::array<Doorbell, 2> split_bells_, count_bells_;
  std::vector<std::unique_ptr<Ring<Text>>> in_;
  std::unique_ptr<Ring<Text>> words_[2][2];
  WordCounts counts_[2];
};

std::unique_ptr<Engine> make(Workload& work) {
  switch (work.options.dag) {
    case Dag::words:
      return std::make_unique<WordsEngine>(work);
    case Dag::fan:
      return std::make_unique<ChainEngine<Number, 4>>(work);
    case Dag::payload:
      return std::make_unique<ChainEngine<Block, 1>>(work);
    default:
      return std::make_unique<ChainEngine<Number, 1>>(work);
  }
}

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  return iotcloud::bench::measure("ring", argc, argv, iotcloud::bench::make);
}
