#include <algorithm>
#include <array>
#include <atomic>
#include <mutex>
#include <random>
#include <thread>

#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/bench/runtime/soak_run.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::bench {

namespace {

using namespace std::chrono_literals;
using topology::Bolt;
using topology::Config;
using topology::MessageId;
using topology::OutputCollector;
using topology::OutputFieldsDeclarer;
using topology::SpoutOutputCollector;
using topology::TopologyContext;
using topology::Tuple;
using topology::Values;

constexpr int spouts = 2, bolt_tasks = 8;
constexpr std::uint64_t keys_of_spout = 500, keys = spouts * keys_of_spout;
constexpr std::size_t most_pending = 4096;
/// How often the source is asked to continue.
constexpr std::int64_t beat_ns = 1'000'000;
/// After a longer pause the source does not catch up.
constexpr std::int64_t longest_debt_ns = 20'000'000;

/// What the tasks share: counts, and error reports.
struct Ledger {
  std::atomic<std::uint64_t> emitted{0}, acked{0}, failed{0}, refused{0}, arrived{0}, out_of_order{0}, overlapping{0},
      unknown_ends{0}, rebalances{0}, pauses{0};
  std::array<std::atomic<int>, keys> task_of_key{};  ///< 0: not known yet
  std::atomic<bool> over{false};
  double rate = 0;  ///< of one spout task, per ns; 0: no limit
  std::mutex mutex;
  std::vector<topology::SpoutWaker> wakers;  ///< guarded by mutex
};

/// Reports when a task is called twice at the same time.
class Serial {
 public:
  Serial(std::atomic<bool>& inside, Ledger& ledger) : inside_(inside) {
    if (inside_.exchange(true, std::memory_order_relaxed)) ++ledger.overlapping;
  }
  ~Serial() { inside_.store(false, std::memory_order_relaxed); }
  Serial(const Serial&) = delete;
  Serial& operator=(const Serial&) = delete;

 private:
  std::atomic<bool>& inside_;
};

/// Emits (key, number): the numbers of a key go up by one.
class Source final : public topology::Spout {
 public:
  explicit Source(Ledger& ledger) : ledger_(ledger) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"key", "number"}); }
  void open(const Config&, const TopologyContext& context, SpoutOutputCollector& collector) override {
    collector_ = &collector;
    first_key_ = static_cast<std::uint64_t>(context.task_index) * keys_of_spout;
    const std::lock_guard lock(ledger_.mutex);
    ledger_.wakers.push_back(context.waker);
  }
  void activate() override { last_ns_ = now_ns(); }
  bool next_tuple() override {
    const Serial serial(inside_, ledger_);
    if (ledger_.over.load(std::memory_order_relaxed) || !may_emit()) return false;
    const MessageId id = next_id_++;
    under_way_[id % under_way_.size()] = id;
    ledger_.emitted.fetch_add(1, std::memory_order_relaxed);
    const std::uint64_t turn = id - 1;
    collector_->emit(Values(first_key_ + turn % keys_of_spout, turn / keys_of_spout + 1), id);
    return true;
  }
  void ack(MessageId id) override { end(id, ledger_.acked); }
  void fail(MessageId id) override { end(id, ledger_.failed); }

 private:
  bool may_emit() {
    if (under_way_[next_id_ % under_way_.size()] != 0) return false;  // a very old one is still under way
    if (ledger_.rate == 0) return true;
    if (allowance_ < 1) {
      const std::int64_t now = now_ns();
      allowance_ += static_cast<double>(std::min(now - last_ns_, longest_debt_ns)) * ledger_.rate;
      last_ns_ = now;
    }
    if (allowance_ < 1) return false;
    allowance_ -= 1;
    return true;
  }
  void end(MessageId id, std::atomic<std::uint64_t>& how) {
    const Serial serial(inside_, ledger_);
    if (std::exchange(under_way_[id % under_way_.size()], 0) != id) ++ledger_.unknown_ends;
    how.fetch_add(1, std::memory_order_relaxed);
  }
  Ledger& ledger_;
  SpoutOutputCollector* collector_ = nullptr;
  std::uint64_t first_key_ = 0;
  MessageId next_id_ = 1;
  std::vector<MessageId> under_way_ = std::vector<MessageId>(16 * most_pending);
  double allowance_ = 0;
  std::int64_t last_ns_ = 0;
  std::atomic<bool> inside_{false};
};

/// Passes tuples on or fails them, at random; sometimes takes two milliseconds.
class Pass final : public Bolt {
 public:
  explicit Pass(Ledger& ledger, std::uint64_t seed) : ledger_(ledger), random_(seed) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"key", "number"}); }
  void prepare(const Config&, const TopologyContext& context, OutputCollector& collector) override {
    collector_ = &collector;
    random_.discard(static_cast<unsigned long long>(context.task) * 1000);
  }
  void execute(const Tuple& tuple) override {
    const Serial serial(inside_, ledger_);
    const std::uint64_t chance = random_();
    if (chance % 100'000 == 0) {
      for (const std::int64_t until = now_ns() + 2'000'000; now_ns() < until;) std::this_thread::yield();
    }
    if (chance % 1000 == 1) {
      ledger_.refused.fetch_add(1, std::memory_order_relaxed);
      collector_->fail(tuple);
      return;
    }
    collector_->emit(tuple, Values(tuple.at(0), tuple.at(1)));
    collector_->ack(tuple);
  }

 private:
  Ledger& ledger_;
  OutputCollector* collector_ = nullptr;
  std::minstd_rand random_;
  std::atomic<bool> inside_{false};
};

/// Checks that each key comes to one task, in order.
class Check final : public Bolt {
 public:
  explicit Check(Ledger& ledger) : ledger_(ledger) {}
  void prepare(const Config&, const TopologyContext& context, OutputCollector& collector) override {
    task_ = context.task;
    collector_ = &collector;
  }
  void execute(const Tuple& tuple) override {
    const Serial serial(inside_, ledger_);
    const auto key = static_cast<std::size_t>(tuple.get<std::int64_t>(0));
    const std::int64_t number = tuple.get<std::int64_t>(1);
    std::atomic<int>& owner = ledger_.task_of_key.at(key);
    if (owner.load(std::memory_order_relaxed) == 0) owner.store(task_, std::memory_order_relaxed);
    if (owner.load(std::memory_order_relaxed) != task_ || number <= last_[key]) ++ledger_.out_of_order;
    last_[key] = number;
    ledger_.arrived.fetch_add(1, std::memory_order_relaxed);
    collector_->ack(tuple);
  }

 private:
  Ledger& ledger_;
  int task_ = 0;
  OutputCollector* collector_ = nullptr;
  std::vector<std::int64_t> last_ = std::vector<std::int64_t>(keys);
  std::atomic<bool> inside_{false};
};

topology::Topology graph(Ledger& ledger, std::uint64_t seed) {
  topology::TopologyBuilder builder;
  builder.set_spout(
      "source", [&ledger] { return std::make_unique<Source>(ledger); }, spouts);
  builder.set_bolt("pass", [&ledger, seed] { return topology::make_bolt<Pass>(ledger, seed); })
      .fields_grouping("source", {"key"})
      .tasks(bolt_tasks);
  builder.set_bolt("check", [&ledger] { return topology::make_bolt<Check>(ledger); })
      .fields_grouping("pass", {"key"})
      .tasks(bolt_tasks);
  return builder.build("soak");
}

topology::RuntimeOptions runtime_options(config::Metrics& metrics) {
  topology::RuntimeOptions all;
  all.metrics = &metrics;
  all.max_spout_pending = most_pending;
  return all;
}

}  // namespace

struct Soak::Impl {
  explicit Impl(const SoakOptions& o)
      : options(o), random(o.seed), runtime(graph(ledger, o.seed), runtime_options(metrics)) {
    ledger.rate = options.rate / spouts * 1e-9;
  }

  /// \return how long to wait before the next disturbance.
  std::chrono::milliseconds disturb() {
    const auto up_to = [this](int most) { return std::uniform_int_distribution<int>(1, most)(random); };
    const int calm = up_to(static_cast<int>(options.longest_calm.count()));
    if (paused) {
      runtime.activate();
      paused = false;
    } else if (up_to(4) == 1) {
      runtime.deactivate();
      paused = true;
      ++ledger.pauses;
      return std::chrono::milliseconds(std::max(1, calm / 4));
    } else {
      runtime.rebalance(up_to(2) == 1 ? "pass" : "check", up_to(bolt_tasks));
      ++ledger.rebalances;
    }
    return std::chrono::milliseconds(calm);
  }

  void wake() {
    // The list is constant after start().
    for (const topology::SpoutWaker& waker : ledger.wakers) waker.wake();
  }

  const SoakOptions options;
  std::mt19937_64 random;
  Ledger ledger;
  config::Metrics metrics;
  topology::Runtime runtime;
  bool paused = false;
  bool stopped_in_time = false;
};

Soak::Soak(const SoakOptions& options) : impl_(std::make_unique<Impl>(options)) {}
Soak::~Soak() = default;

void Soak::run(const std::function<void(const SoakCounts&, std::chrono::milliseconds left)>& progress) {
  Impl& soak = *impl_;
  soak.runtime.start();
  using Clock = std::chrono::steady_clock;
  const auto ends = Clock::now() + soak.options.length;
  auto disturbs = Clock::now() + soak.options.longest_calm, tells = Clock::now() + 1s;
  for (std::int64_t beat = now_ns(); Clock::now() < ends; beat = std::max(beat + beat_ns, now_ns() - beat_ns)) {
    sleep_until(beat);
    soak.wake();
    const auto now = Clock::now();
    if (soak.options.longest_calm.count() > 0 && now >= disturbs) disturbs = now + soak.disturb();
    if (progress && now >= tells) {
      tells += 1s;
      progress(counts(), std::chrono::duration_cast<std::chrono::milliseconds>(ends - now));
    }
  }
  soak.ledger.over = true;
  if (soak.paused) soak.runtime.activate();
  soak.stopped_in_time = soak.runtime.stop(soak.options.longest_drain);
}

SoakCounts Soak::counts() const {
  const Ledger& l = impl_->ledger;
  SoakCounts c;
  c.emitted = l.emitted, c.acked = l.acked, c.failed = l.failed, c.refused = l.refused, c.arrived = l.arrived;
  c.out_of_order = l.out_of_order, c.overlapping = l.overlapping, c.unknown_ends = l.unknown_ends;
  c.rebalances = l.rebalances, c.pauses = l.pauses;
  return c;
}

std::vector<std::string> Soak::violations() const {
  const SoakCounts c = counts();
  const topology::TaskSnapshot source = impl_->runtime.snapshot().component("source");
  std::vector<std::string> all;
  const auto equal = [&](const char* what, std::uint64_t is, const char* other, std::uint64_t should) {
    if (is != should)
      all.push_back(std::string(what) + " is " + std::to_string(is) + ", but " + other + " is " +
                    std::to_string(should));
  };
  equal("acked + failed", c.acked + c.failed, "emitted", c.emitted);
  equal("failed", c.failed, "what a bolt failed", c.refused);
  equal("what arrived at the last bolt", c.arrived, "acked", c.acked);
  equal("out of order", c.out_of_order, "that which is allowed", 0);
  equal("overlapping calls of one task", c.overlapping, "that which is allowed", 0);
  equal("ends of tuples that were not under way", c.unknown_ends, "that which is allowed", 0);
  equal("the runtime's count of emitted", source.emitted, "the spouts' own", c.emitted);
  equal("the runtime's count of acked", source.acked, "the spouts' own", c.acked);
  equal("the runtime's count of failed", source.failed, "the spouts' own", c.failed);
  if (!impl_->stopped_in_time) all.push_back("the topology did not drain and stop in time");
  if (c.emitted == 0) all.push_back("nothing was emitted");
  return all;
}

}  // namespace iotcloud::bench
