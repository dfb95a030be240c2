// The DAGs as plain calls on one thread: no queues, no other core, no acks. This is the cost of the work itself. At a
// low rate it is the limit for a runtime that runs a tuple to completion on the thread that brought it. Slowed down to
// the highest rate of another engine (--most), it shows which latency that engine would have if nothing but the machine
// held it up: when the machine stops the thread for a while, what came meanwhile waits until it is worked off.
#include <algorithm>
#include <functional>

#include <iotcloud/bench/runtime/measure.h>

namespace iotcloud::bench {

namespace {

/// One bolt's call; virtual, because a runtime does not know its bolts either.
class Stage {
 public:
  virtual ~Stage() = default;
  virtual void execute(std::uint64_t n, const std::string& text, const brokers::Payload& payload) = 0;
};

class Sink final : public Stage {
 public:
  explicit Sink(Workload& work) : work_(work) {}
  void execute(std::uint64_t n, const std::string&, const brokers::Payload& payload) override {
    if (work_.options.dag == Dag::payload && !work_.payloads.is_same(n, payload)) ++work_.wrong;
    work_.arrivals[0].arrived(work_.feed, n);
  }

 private:
  Workload& work_;
};

class Pass final : public Stage {
 public:
  explicit Pass(Stage& next) : next_(next) {}
  void execute(std::uint64_t n, const std::string& text, const brokers::Payload& payload) override {
    next_.execute(n, text, payload);
  }

 private:
  Stage& next_;
};

class Count final : public Stage {
 public:
  Count(Workload& work, std::size_t task) : work_(work), task_(task) {}
  void execute(std::uint64_t n, const std::string& word, const brokers::Payload&) override {
    ++counts_[word];
    work_.arrivals[task_].arrived(work_.feed, n);
  }

 private:
  Workload& work_;
  const std::size_t task_;
  WordCounts counts_;
};

class Split final : public Stage {
 public:
  Split(Stage& even, Stage& odd) : counts_{&even, &odd} {}
  void execute(std::uint64_t n, const std::string& sentence, const brokers::Payload& none) override {
    split(sentence, [&](std::string_view word) {
      counts_[std::hash<std::string_view>{}(word) % 2]->execute(n, std::string(word), none);
    });
  }

 private:
  Stage* const counts_[2];
};

class CallsEngine final : public Engine {
 public:
  explicit CallsEngine(Workload& work) : work_(work), sink_(work), counts_{{work, 0}, {work, 1}} {
    if (work.options.most > 0) {
      const double item_ns = 1e9 * static_cast<double>(results_of_item(work.options.dag)) / work.options.most;
      items_of_step_ = std::max<std::uint64_t>(1, static_cast<std::uint64_t>(least_step_ns / item_ns));
      step_ns_ = static_cast<std::int64_t>(static_cast<double>(items_of_step_) * item_ns);
    }
    const bool words = work.options.dag == Dag::words;
    const std::size_t width = words ? 2 : work.options.dag == Dag::fan ? 4 : 1;
    for (std::size_t i = 0; i < width; ++i) {
      if (words) {
        second_.push_back(std::make_unique<Split>(counts_[0], counts_[1]));
      } else {
        second_.push_back(std::make_unique<Pass>(sink_));
      }
    }
  }
  void pump() override {
    const Dag dag = work_.options.dag;
    std::int64_t began_ns = now_ns();
    for (std::uint64_t taken = 0; work_.feed.due(); ++taken) {
      if (step_ns_ > 0 && taken == items_of_step_) {
        while (now_ns() - began_ns < step_ns_) {
        }
        began_ns = now_ns();
        taken = 0;
      }
      const std::uint64_t n = work_.feed.take();
      // The source owns its item, as in every engine.
      const std::string text = dag == Dag::words ? work_.sentences[n] : std::string();
      const brokers::Payload payload = dag == Dag::payload ? work_.payloads[n] : brokers::Payload();
      second_[n % second_.size()]->execute(n, text, payload);
    }
  }
  void stop() override {}

 private:
  Workload& work_;
  Sink sink_;
  Count counts_[2];
  std::vector<std::unique_ptr<Stage>> second_;
  // If the calls are slowed down: after so many items the thread waits until so much time has passed since the last
  // wait.
  static constexpr double least_step_ns = 5000;  // the clock is read seldom enough to cost nothing
  std::uint64_t items_of_step_ = 0;
  std::int64_t step_ns_ = 0;
};

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  return iotcloud::bench::measure("calls", argc, argv, [](iotcloud::bench::Workload& work) {
    return std::make_unique<iotcloud::bench::CallsEngine>(work);
  });
}
