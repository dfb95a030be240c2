// The C++ of the mix. Nothing here knows that components in Java and Python stand beside it, or of Storm.
#include <array>
#include <chrono>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/topology/plugin.h>

namespace {

using namespace iotcloud::topology;

struct Reading {
  const char* name;
  std::int64_t number;
  double level;
};

/// Keys that languages write in different ways: letters beyond ASCII, numbers below zero and beyond 32 bits, doubles
/// of many digits.
constexpr std::array readings{Reading{"Z\xC3\xBCrich", -3, 0.1 + 0.2},
                              Reading{"Bloomington", 7, -2.5},
                              Reading{"\xE6\x9D\xB1\xE4\xBA\xAC", 5'000'000'000, 1e-7},
                              Reading{"", 0, 2.0},
                              Reading{"two words", -40, 1.0 / 3},
                              Reading{"Quito", 128, -1e21}};

/// Emits each reading `rounds` times. When all are done, it says how many were acked and how many failed.
class Readings final : public Spout {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"name", "number", "level"});
    declarer.declare_stream("finished", Fields{"acked", "failed"});
  }
  void open(const Config& config, const TopologyContext&, SpoutOutputCollector& collector) override {
    count_ = std::stoull(config.at("rounds")) * readings.size();
    collector_ = &collector;
  }
  bool next_tuple() override {
    if (emitted_ < count_) {
      const Reading& reading = readings[emitted_ % readings.size()];
      collector_->emit(Values(reading.name, reading.number, reading.level), emitted_++);
      return true;
    }
    if (acked_ + failed_ == count_ && !std::exchange(finished_, true))
      collector_->emit_to("finished", Values(acked_, failed_));
    return false;
  }
  void ack(MessageId) override { ++acked_; }
  void fail(MessageId) override { ++failed_; }
  std::chrono::microseconds poll_period() const override { return std::chrono::milliseconds(10); }

 private:
  SpoutOutputCollector* collector_ = nullptr;
  std::uint64_t count_ = 0;
  std::uint64_t emitted_ = 0;
  std::uint64_t acked_ = 0;
  std::uint64_t failed_ = 0;
  bool finished_ = false;
};

/// Sends numbers below zero to the first task, others to the last one.
class BySign final : public Grouping {
 public:
  void prepare(const TopologyContext&, const Fields& fields, std::span<const int> targets) override {
    number_ = fields.find("number").value();
    targets_ = targets;
  }
  void choose(const Values& values, std::vector<int>& chosen) override {
    chosen.push_back(std::get<std::int64_t>(values[number_]) < 0 ? targets_.front() : targets_.back());
  }

 private:
  std::size_t number_ = 0;
  std::span<const int> targets_;
};

/// Emits each reading again, and by whom: "C++", with the number of the task.
class Relay final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"name", "number", "level", "by"});
  }
  void prepare(const Config&, const TopologyContext& context) override {
    by_ = "C++ " + std::to_string(context.task_index);
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    collector.emit(Values(tuple.at("name"), tuple.at("number"), tuple.at("level"), by_));
  }

 private:
  std::string by_;
};

/// Counts how often each name came by whom.
class CountNames final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"key", "by", "count", "task"});
  }
  void prepare(const Config&, const TopologyContext& context) override { task_ = context.task; }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const auto& name = tuple.get<std::string>("name");
    const auto& by = tuple.get<std::string>("by");
    collector.emit(Values(name, by, ++counts_[{name, by}], task_));
  }

 private:
  std::map<std::pair<std::string, std::string>, std::int64_t> counts_;
  int task_ = 0;
};

}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_spout<Readings>("mix.Readings");
  registry.add_bolt<Relay>("mix.Relay");
  registry.add_bolt<CountNames>("mix.CountNames");
  registry.add_grouping<BySign>("mix.BySign");
}
