// A component library for topologies on Storm. Its bolts and spouts write what they counted into files of the folder
// `out`, one for each task, which the test reads.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <deque>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include <unistd.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/windows/windowed_bolt.h>

namespace {

namespace topology = iotcloud::topology;
using topology::Config;
using topology::Fields;
using topology::Tuple;
using topology::Values;

const iotcloud::config::Logger logger{"test"};

/// A file that is replaced as a whole.
void write_file(const Config& config, const topology::TopologyContext& context, const std::string& text) {
  const auto path = std::filesystem::path(config.at("out")) / (context.component + "." + std::to_string(context.task));
  const std::string partial = path.string() + ".partial";
  std::ofstream(partial) << text;
  std::filesystem::rename(partial, path);
}

/// The size of a number's payload. Large ones take another way through Java than small ones.
std::size_t payload_size(std::int64_t n) {
  return n % 40 == 0 ? 20'000 : static_cast<std::size_t>(n % 300);
}

/// Emits the numbers 1 to `count` with a key of ten, a payload and a text, and again those that failed; when
/// `told_from` of them (default: all) are done says how many were done and how often one failed. On the stream `chosen`
/// it names the tasks of the component `direct` in turn.
class Numbers final : public topology::Spout {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"n", "key", "payload", "text"});
    declarer.declare_stream("chosen", Fields{"n", "key"}, true);
  }
  void open(const Config& config, const topology::TopologyContext& context,
            topology::SpoutOutputCollector& collector) override {
    config_ = config;
    context_ = &context;
    collector_ = &collector;
    count_ = std::stoll(config.at("count"));
    told_from_ = config.contains("told_from") ? std::stoll(config.at("told_from")) : count_;
  }
  bool next_tuple() override {
    if (!again_.empty()) {
      emit(again_.front());
      again_.pop_front();
      return true;
    }
    if (next_ > count_) return false;
    const std::int64_t n = next_++;
    emit(n);
    if (const auto readers = context_->tasks_of->find("direct"); readers != context_->tasks_of->end()) {
      const auto task = static_cast<std::size_t>(n) % readers->second.size();
      collector_->emit_direct(readers->second[task], "chosen", Values(n, "k" + std::to_string(n % 10)));
    }
    return true;
  }
  void ack(topology::MessageId) override {
    ++acked_;
    write();
  }
  void fail(topology::MessageId id) override {
    ++failed_;
    again_.push_back(static_cast<std::int64_t>(id));
    write();
  }

 private:
  void emit(std::int64_t n) {
    const std::string key = "k" + std::to_string(n % 10);
    collector_->emit(Values(n, key, topology::Payload::copy(std::string(payload_size(n), 'x')), "z\xC3\xA4hlt " + key),
                     static_cast<topology::MessageId>(n));
  }
  void write() {
    if (acked_ < told_from_) return;
    write_file(config_, *context_, "done " + std::to_string(acked_) + "\nfailed " + std::to_string(failed_) + "\n");
  }

  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  topology::SpoutOutputCollector* collector_ = nullptr;
  std::int64_t count_ = 0;
  std::int64_t told_from_ = 0;
  std::int64_t next_ = 1;
  std::int64_t acked_ = 0;
  std::int64_t failed_ = 0;
  std::deque<std::int64_t> again_;
};

/// Emits a number every `period_ms`, and those that failed again. Writes the calls of activate() and deactivate(), and
/// how many numbers it emitted and were acked.
class Steady final : public topology::Spout {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"n", "key"});
  }
  void open(const Config& config, const topology::TopologyContext& context,
            topology::SpoutOutputCollector& collector) override {
    config_ = config;
    context_ = &context;
    collector_ = &collector;
    period_ = std::chrono::milliseconds(std::stoll(config.at("period_ms")));
    next_ = context.clock->now();
    emissions_ = &context.metrics->counter("test_emissions_total", "Tuples that Steady emitted");
  }
  bool next_tuple() override {
    if (context_->clock->now() < next_) return false;
    next_ += period_;
    std::int64_t n = ++emitted_;
    if (!again_.empty()) {
      n = again_.front();
      again_.pop_front();
      --emitted_;
    }
    collector_->emit(Values(n, "k" + std::to_string(n % 10)), static_cast<topology::MessageId>(n));
    logger.debug("number {} is emitted", n);
    emissions_->add();
    write();
    return true;
  }
  void activate() override {
    ++activated_;
    write();
  }
  void deactivate() override {
    ++deactivated_;
    write();
  }
  void ack(topology::MessageId) override {
    ++acked_;
    write();
  }
  void fail(topology::MessageId id) override { again_.push_back(static_cast<std::int64_t>(id)); }

 private:
  void write() {
    write_file(config_, *context_,
               "emitted " + std::to_string(emitted_) + "\nacked " + std::to_string(acked_) + "\nactivated " +
                   std::to_string(activated_) + "\ndeactivated " + std::to_string(deactivated_) + "\n");
  }

  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  topology::SpoutOutputCollector* collector_ = nullptr;
  std::chrono::milliseconds period_{0};
  iotcloud::config::Clock::Instant next_;
  iotcloud::config::Counter* emissions_ = nullptr;
  std::int64_t emitted_ = 0;
  std::int64_t acked_ = 0;
  std::int64_t activated_ = 0;
  std::int64_t deactivated_ = 0;
  std::deque<std::int64_t> again_;
};

/// The frame that a crash's report must name.
[[gnu::noinline]] void crash_of_the_test() {
  volatile int* volatile nowhere = nullptr;
  *nowhere = 1;
}

/// Crashes when the file `crash` appears in the folder `out`, which it removes first.
class Crash final : public topology::BasicBolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext&) override {
    file_ = std::filesystem::path(config.at("out")) / "crash";
  }
  void execute(const Tuple&, topology::BasicOutputCollector&) override {
    if (std::filesystem::remove(file_)) crash_of_the_test();
  }

 private:
  std::filesystem::path file_;
};

/// Emits what it gets.
class Relay : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"n", "key", "payload", "text"});
  }
  void execute(const Tuple& tuple, topology::BasicOutputCollector& collector) override {
    collector.emit(Values(tuple.at("n"), tuple.at("key"), tuple.at("payload"), tuple.at("text")));
  }
};

/// Executes its first tuple for 3 s, longer than the deadline of those that wait behind it.
class Slow final : public Relay {
 public:
  void execute(const Tuple& tuple, topology::BasicOutputCollector& collector) override {
    if (first_) std::this_thread::sleep_for(std::chrono::seconds(3));
    first_ = false;
    Relay::execute(tuple, collector);
  }

 private:
  bool first_ = true;
};

/// Emits what it gets; throws at the first copy of every hundredth number that it gets.
class Fussy final : public Relay {
 public:
  void execute(const Tuple& tuple, topology::BasicOutputCollector& collector) override {
    const auto n = tuple.get<std::int64_t>("n");
    if (n % 100 == 0 && refused_.insert(n).second) throw std::runtime_error("not number " + std::to_string(n));
    Relay::execute(tuple, collector);
  }

 private:
  std::set<std::int64_t> refused_;
};

/// Emits what it gets, and acks it from a thread of its own.
class Later final : public topology::Bolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"n", "key", "payload", "text"});
  }
  void prepare(const Config&, const topology::TopologyContext&, topology::OutputCollector& collector) override {
    collector_ = &collector;
  }
  void execute(const Tuple& tuple) override {
    collector_->emit(tuple, Values(tuple.at("n"), tuple.at("key"), tuple.at("payload"), tuple.at("text")));
    std::thread([this, tuple] { collector_->ack(tuple); }).join();
  }

 private:
  topology::OutputCollector* collector_ = nullptr;
};

/// Counts tuples by their key, and different numbers, and whether all fields came as they were emitted; writes the
/// counts at ticks.
class Count final : public topology::BasicBolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext& context) override {
    config_ = config;
    context_ = &context;
  }
  void execute(const Tuple& tuple, topology::BasicOutputCollector&) override {
    if (tuple.is_tick()) {
      ++ticks_;
      if (changed_) write();
      return;
    }
    changed_ = true;
    const auto n = tuple.get<std::int64_t>("n");
    const auto& key = tuple.get<std::string>("key");
    ++by_key_[key];
    numbers_.insert(n);
    if (tuple.size() == 2) return;
    const bool intact = tuple.get<topology::Payload>("payload").text() == std::string(payload_size(n), 'x') &&
                        tuple.get<std::string>("text") == "z\xC3\xA4hlt " + key;
    if (!intact) ++damaged_;
  }

 private:
  void write() {
    changed_ = false;
    std::string text = "process " + std::to_string(getpid()) + "\nnumbers " + std::to_string(numbers_.size()) +
                       "\ndamaged " + std::to_string(damaged_) + "\nticks " + std::to_string(ticks_) + "\n";
    for (const auto& [key, count] : by_key_) text += key + " " + std::to_string(count) + "\n";
    write_file(config_, *context_, text);
  }

  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  bool changed_ = false;
  std::int64_t ticks_ = 0;
  std::int64_t damaged_ = 0;
  std::map<std::string, std::int64_t> by_key_;
  std::set<std::int64_t> numbers_;
};

/// Emits each number with two keys and a value of each other kind.
class Mixed final : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"n", "half", "key", "none", "even", "quarter"});
  }
  void execute(const Tuple& tuple, topology::BasicOutputCollector& collector) override {
    const auto n = tuple.get<std::int64_t>("n");
    const bool even = n % 2 == 0;
    collector.emit(Values(n, even ? "a" : "b", tuple.at("key"), topology::Value(), even, static_cast<double>(n) / 4));
  }
};

/// Counts what Mixed emits by both keys, and whether the other values came as they were emitted; writes the counts at
/// ticks.
class Typed final : public topology::BasicBolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext& context) override {
    config_ = config;
    context_ = &context;
  }
  void execute(const Tuple& tuple, topology::BasicOutputCollector&) override {
    if (tuple.is_tick()) {
      std::string text = "damaged " + std::to_string(damaged_) + "\n";
      for (const auto& [keys, count] : by_keys_) text += keys + " " + std::to_string(count) + "\n";
      return write_file(config_, *context_, text);
    }
    const auto n = tuple.get<std::int64_t>("n");
    ++by_keys_[tuple.get<std::string>("half") + tuple.get<std::string>("key")];
    const bool intact = std::holds_alternative<std::monostate>(tuple.at("none")) &&
                        tuple.get<bool>("even") == (n % 2 == 0) &&
                        tuple.get<double>("quarter") == static_cast<double>(n) / 4;
    if (!intact) ++damaged_;
  }

 private:
  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  std::int64_t damaged_ = 0;
  std::map<std::string, std::int64_t> by_keys_;
};

/// Emits of each window how many numbers are in it, and their sum.
class Window final : public topology::WindowedBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"count", "sum"});
  }
  void prepare(const Config&, const topology::TopologyContext&, topology::WindowOutputCollector& collector) override {
    collector_ = &collector;
  }
  void execute(const topology::TupleWindow& window) override {
    std::int64_t sum = 0;
    for (const Tuple& tuple : window.tuples()) sum += tuple.get<std::int64_t>("n");
    collector_->emit(Values(static_cast<std::int64_t>(window.tuples().size()), sum));
  }

 private:
  topology::WindowOutputCollector* collector_ = nullptr;
};

/// Adds up windows.
class Sums final : public topology::BasicBolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext& context) override {
    config_ = config;
    context_ = &context;
  }
  void execute(const Tuple& tuple, topology::BasicOutputCollector&) override {
    ++windows_;
    numbers_ += tuple.get<std::int64_t>("count");
    sum_ += tuple.get<std::int64_t>("sum");
    write_file(config_, *context_,
               "windows " + std::to_string(windows_) + "\nnumbers " + std::to_string(numbers_) + "\nsum " +
                   std::to_string(sum_) + "\n");
  }

 private:
  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  std::int64_t windows_ = 0;
  std::int64_t numbers_ = 0;
  std::int64_t sum_ = 0;
};

/// Keeps tuples until the file `release` is in the folder `out`; with `reset` it begins their time-outs anew at each
/// tick.
class Holder final : public topology::Bolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext&, topology::OutputCollector& collector) override {
    file_ = std::filesystem::path(config.at("out")) / "release";
    resets_ = config.contains("reset");
    collector_ = &collector;
  }
  void execute(const Tuple& tuple) override {
    if (!tuple.is_tick()) return held_.push_back(tuple);
    const bool released = std::filesystem::exists(file_);
    for (const Tuple& held : held_) {
      if (released)
        collector_->ack(held);
      else if (resets_)
        collector_->reset_timeout(held);
    }
    if (released) held_.clear();
  }

 private:
  std::filesystem::path file_;
  bool resets_ = false;
  topology::OutputCollector* collector_ = nullptr;
  std::vector<Tuple> held_;
};

/// Its second execute() lets another thread ack the first tuple, and returns when the test has written into the pipe
/// `go`. Writes whether it hangs, and its ticks.
class Hangs final : public topology::Bolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext& context,
               topology::OutputCollector& collector) override {
    config_ = config;
    context_ = &context;
    collector_ = &collector;
  }
  void execute(const Tuple& tuple) override {
    if (tuple.is_tick()) {
      ++ticks_;
      return write(false);
    }
    if (++executed_ == 1) {
      first_ = tuple;
      return;
    }
    if (executed_ == 2) {
      write(true);
      std::thread([this] { collector_->ack(first_); }).join();
      std::ifstream(std::filesystem::path(config_.at("out")) / "go").get();
    }
    collector_->ack(tuple);
  }

 private:
  void write(bool hangs) {
    write_file(config_, *context_,
               std::string("hangs ") + (hangs ? "1" : "0") + "\nticks " + std::to_string(ticks_) + "\n");
  }

  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  topology::OutputCollector* collector_ = nullptr;
  std::int64_t executed_ = 0;
  std::int64_t ticks_ = 0;
  Tuple first_;
};

/// Emits number and key, and acks the tuple from a thread of its own.
class Aside final : public topology::Bolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"n", "key"});
  }
  void prepare(const Config&, const topology::TopologyContext&, topology::OutputCollector& collector) override {
    collector_ = &collector;
  }
  void execute(const Tuple& tuple) override {
    collector_->emit(tuple, Values(tuple.at("n"), tuple.at("key")));
    std::thread([this, tuple] { collector_->ack(tuple); }).join();
  }

 private:
  topology::OutputCollector* collector_ = nullptr;
};

/// The number of a load generator's message, from 0 on (drivers/loadgen/load_generator.h).
std::int64_t number_of(const Tuple& message) {
  constexpr std::size_t place = 16;
  std::uint64_t number = 0;
  const auto bytes = message.get<topology::Payload>("data").bytes();
  if (bytes.size() < place + sizeof number) throw std::runtime_error("it is not of a load generator");
  std::memcpy(&number, bytes.data() + place, sizeof number);
  return static_cast<std::int64_t>(number);
}

/// Emits the number and the driver of a load generator's message; fails one whose metadata are not true.
class Unpack final : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"n", "key"});
  }
  void prepare(const Config&, const topology::TopologyContext& context) override { context_ = &context; }
  void execute(const Tuple& tuple, topology::BasicOutputCollector& collector) override {
    constexpr std::int64_t hour_ms = 3'600'000;
    const std::int64_t age_ms = context_->clock->wall_ms() - tuple.get<std::int64_t>("time");
    const bool is_true = tuple.get<std::string>("gatewayID") == "gateway-1" &&
                         tuple.get<std::string>("channel") == "data" && !tuple.get<bool>("redelivered") &&
                         age_ms >= 0 && age_ms < hour_ms;
    if (!is_true) throw std::runtime_error("the metadata are not true");
    collector.emit(Values(number_of(tuple), tuple.at("driverID")));
  }

 private:
  const topology::TopologyContext* context_ = nullptr;
};

/// Joins the messages of two drivers that have one number: a pair is acked when its second one comes. Writes how many
/// pairs it has, how many messages wait for the other driver's, and how many came twice.
class Join final : public topology::Bolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext& context,
               topology::OutputCollector& collector) override {
    config_ = config;
    context_ = &context;
    collector_ = &collector;
  }
  void execute(const Tuple& tuple) override {
    const auto n = tuple.get<std::int64_t>("n");
    const auto first = waiting_.find(n);
    if (pairs_.contains(n) || (first != waiting_.end() && first->second.at("key") == tuple.at("key"))) {
      ++twice_;
      collector_->ack(tuple);
    } else if (first == waiting_.end()) {
      waiting_.emplace(n, tuple);
    } else {
      pairs_.insert(n);
      collector_->ack(first->second);
      collector_->ack(tuple);
      waiting_.erase(first);
    }
    write_file(config_, *context_,
               "pairs " + std::to_string(pairs_.size()) + "\nwaiting " + std::to_string(waiting_.size()) + "\ntwice " +
                   std::to_string(twice_) + "\nprocess " + std::to_string(getpid()) + "\n");
  }

 private:
  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  topology::OutputCollector* collector_ = nullptr;
  std::map<std::int64_t, Tuple> waiting_;
  std::set<std::int64_t> pairs_;
  std::int64_t twice_ = 0;
};

/// Passes a load generator's messages on, but waits while the file `shut` is in the folder `out`. Writes how many came,
/// and the number of the last one, before it waits.
class Gate final : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"data", "driverID", "time"});
  }
  void prepare(const Config& config, const topology::TopologyContext& context) override {
    config_ = config;
    context_ = &context;
  }
  void execute(const Tuple& tuple, topology::BasicOutputCollector& collector) override {
    write_file(config_, *context_,
               "came " + std::to_string(++came_) + "\nlast " + std::to_string(number_of(tuple)) + "\n");
    while (std::filesystem::exists(std::filesystem::path(config_.at("out")) / "shut"))
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    collector.emit(Values(tuple.at("data"), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  std::int64_t came_ = 0;
};

/// Its first execute() returns when the test has written into the pipe `go`. Writes how many tuples it executed, and
/// the number that it executed last of each key.
class Newest final : public topology::BasicBolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext& context) override {
    config_ = config;
    context_ = &context;
  }
  void execute(const Tuple& tuple, topology::BasicOutputCollector&) override {
    if (executed_++ == 0) std::ifstream(std::filesystem::path(config_.at("out")) / "go").get();
    newest_[tuple.get<std::string>("key")] = tuple.get<std::int64_t>("n");
    std::string text = "executed " + std::to_string(executed_) + "\n";
    for (const auto& [key, number] : newest_) text += key + " " + std::to_string(number) + "\n";
    write_file(config_, *context_, text);
  }

 private:
  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  std::int64_t executed_ = 0;
  std::map<std::string, std::int64_t> newest_;
};

/// Which task of the spout brought each driver's last message. Writes how many drivers each task has, and how old each
/// driver's first message was when it came.
class Readers final : public topology::BasicBolt {
 public:
  void prepare(const Config& config, const topology::TopologyContext& context) override {
    config_ = config;
    context_ = &context;
  }
  void execute(const Tuple& tuple, topology::BasicOutputCollector&) override {
    if (tuple.is_tick()) {
      if (changed_) write();
      return;
    }
    const auto& driver = tuple.get<std::string>("driverID");
    const auto [known, fresh] = readers_.try_emplace(driver, 0);
    changed_ |= known->second != tuple.source_task();
    known->second = tuple.source_task();
    if (fresh) ages_ms_[driver] = context_->clock->wall_ms() - tuple.get<std::int64_t>("time");
  }

 private:
  void write() {
    changed_ = false;
    std::map<int, int> drivers;
    for (const auto& [driver, task] : readers_) ++drivers[task];
    std::string text;
    for (const auto& [task, count] : drivers)
      text += "task-" + std::to_string(task) + " " + std::to_string(count) + "\n";
    for (const auto& [driver, age] : ages_ms_) text += "driver-" + driver + " " + std::to_string(age) + "\n";
    write_file(config_, *context_, text);
  }

  Config config_;
  const topology::TopologyContext* context_ = nullptr;
  bool changed_ = false;
  std::map<std::string, int> readers_;
  std::map<std::string, std::int64_t> ages_ms_;
};

/// Chooses the task whose place is the number modulo the count of tasks.
class ByNumber : public topology::Grouping {
 public:
  void prepare(const topology::TopologyContext&, const Fields& fields, std::span<const int> targets) override {
    place_ = fields.find("n").value();
    targets_ = targets;
  }
  void choose(const Values& values, std::vector<int>& chosen) override {
    const auto n = static_cast<std::size_t>(std::get<std::int64_t>(values[place_]));
    chosen.push_back(targets_[n % targets_.size()]);
  }

 private:
  std::size_t place_ = 0;
  std::span<const int> targets_;
};

/// The same, but it throws at the first copy of every hundredth number that its task emits.
class Picky final : public ByNumber {
 public:
  void prepare(const topology::TopologyContext& context, const Fields& fields, std::span<const int> targets) override {
    number_ = fields.find("n").value();
    ByNumber::prepare(context, fields, targets);
  }
  void choose(const Values& values, std::vector<int>& chosen) override {
    const auto n = std::get<std::int64_t>(values[number_]);
    if (n % 100 == 0 && refused_.insert(n).second) throw std::runtime_error("nobody takes number " + std::to_string(n));
    ByNumber::choose(values, chosen);
  }

 private:
  std::size_t number_ = 0;
  std::set<std::int64_t> refused_;
};

}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_spout<Numbers>("test.Numbers");
  registry.add_spout<Steady>("test.Steady");
  registry.add_bolt<Crash>("test.Crash");
  registry.add_bolt<Slow>("test.Slow");
  registry.add_bolt<Fussy>("test.Fussy");
  registry.add_bolt<Relay>("test.Relay");
  registry.add_bolt<Later>("test.Later");
  registry.add_bolt<Count>("test.Count");
  registry.add_bolt<Mixed>("test.Mixed");
  registry.add_bolt<Typed>("test.Typed");
  registry.add_bolt("test.Window", topology::make_windowed_bolt<Window>({.length = 100}));
  registry.add_bolt<Sums>("test.Sums");
  registry.add_bolt<Holder>("test.Holder");
  registry.add_bolt<Hangs>("test.Hangs");
  registry.add_bolt<Aside>("test.Aside");
  registry.add_bolt<Unpack>("test.Unpack");
  registry.add_bolt<Join>("test.Join");
  registry.add_bolt<Gate>("test.Gate");
  registry.add_bolt<Newest>("test.Newest");
  registry.add_bolt<Readers>("test.Readers");
  registry.add_grouping<ByNumber>("test.ByNumber");
  registry.add_grouping<Picky>("test.Picky");
}
