// What a task's C++ side makes of the calls of Java: a test plays Java, and reads the commands.
#include <algorithm>
#include <atomic>
#include <bit>
#include <chrono>
#include <cstring>
#include <deque>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <unistd.h>

#include "iotcloud/tests/config/hand_clock.h"
#include <iotcloud/rpc/http/http_client.h>
#include <iotcloud/topology/storm/shim/bolt_host.h>
#include <iotcloud/topology/storm/shim/call_timer.h>
#include <iotcloud/topology/storm/shim/grouping_host.h>
#include <iotcloud/topology/storm/shim/parcel.h>
#include <iotcloud/topology/storm/shim/spout_host.h>
#include <iotcloud/topology/storm/shim/worker_pages.h>
#include <iotcloud/topology/storm/value_format.h>

namespace iotcloud::topology::storm {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

/// The Java side of a task: its buffer, and the commands that it applied, as texts.
class Java final : public CommandSink {
 public:
  explicit Java(std::size_t size = 1024) : buffer_(size) {}
  std::span<std::byte> buffer() { return buffer_; }
  void apply(std::size_t size) override {
    at_ = buffer_.data();
    while (at_ < buffer_.data() + size) commands.push_back(command());
  }
  std::span<std::byte> grow(std::size_t size) override {
    buffer_.resize(size);
    return buffer_;
  }
  void add_array(std::span<const std::byte> bytes) override {
    arrays_.push_back(std::to_string(bytes.size()) + static_cast<char>(bytes.front()));
    most_arrays = std::max(most_arrays, arrays_.size());
  }
  void wake() noexcept override { ++wakes; }

  std::vector<std::string> taken() { return std::exchange(commands, {}); }

  std::vector<std::string> commands;
  int wakes = 0;
  std::size_t most_arrays = 0;  ///< that waited for their commands at a time
  std::vector<ParcelPtr> parcels;
  std::size_t told = 0;  ///< so many strings are told of each parcel

 private:
  template <typename Number>
  Number number() {
    Number value{};
    std::memcpy(&value, at_, sizeof value);
    at_ += sizeof value;
    return value;
  }
  /// A string among the values.
  std::string string() {
    EXPECT_EQ(number<std::uint8_t>(), 5);
    const auto size = number<std::uint32_t>();
    std::string text(reinterpret_cast<const char*>(at_), size);
    at_ += size;
    return text;
  }
  std::string command() {
    static constexpr const char* answers[] = {"", "", "ack", "fail", "reset", "forget", "", "", "executes"};
    const auto kind = number<std::uint8_t>();
    if (kind == 1 || kind == 7) return emit(kind == 1);
    if (kind == 6) {
      const auto size = number<std::uint32_t>();
      std::string text(reinterpret_cast<const char*>(at_), size);
      at_ += size;
      return "error " + text;
    }
    return answers[kind] + (" " + std::to_string(number<std::uint32_t>()));
  }
  std::string emit(bool bolt) {
    std::string text = "emit stream " + std::to_string(number<std::uint16_t>());
    const auto task = number<std::int32_t>();
    if (task >= 0) text += " task " + std::to_string(task);
    if (bolt) {
      for (auto count = number<std::uint32_t>(); count > 0; --count)
        text += " @" + std::to_string(number<std::uint32_t>());
    } else {
      const bool tracked = number<std::uint8_t>() != 0;
      const auto id = number<std::uint64_t>();
      if (tracked) text += " id " + std::to_string(id);
    }
    // The values' size is not said: one string of few bytes, or one payload, is all that these tests emit, and births
    // after it.
    std::byte* begin = at_;
    const auto count = number<std::uint32_t>();
    if (count == static_cast<std::uint32_t>(-1)) {
      parcels.emplace_back(std::bit_cast<Parcel*>(number<std::uintptr_t>()));
      text += ": parcel of " + std::to_string(number<std::uint32_t>());
      for (std::size_t i = 0; i < told; ++i) text += ", " + string();
      return text;
    }
    const auto kind = number<std::uint8_t>();
    if (kind == 7) {
      const auto slot = number<std::uint32_t>();
      return text + ": value " + std::to_string(number<std::uint32_t>()) + " of @" + std::to_string(slot);
    }
    if (kind == 8) {
      text += ": array " + arrays_.front();
      arrays_.pop_front();
      return text;
    }
    at_ += number<std::uint32_t>();
    if (count > 1) at_ += 9;
    const Values values = decode_values({begin, static_cast<std::size_t>(at_ - begin)});
    const auto* payload = std::get_if<Payload>(&values[0]);
    text += ": " + (payload != nullptr ? std::string(payload->text()) : std::get<std::string>(values[0]));
    return count > 1 ? text + ", born" : text;
  }

  std::vector<std::byte> buffer_;
  std::byte* at_ = nullptr;
  std::deque<std::string> arrays_;  ///< the size of each, and its first byte
};

TaskDescription described(bool births = false) {
  TaskDescription task;
  task.file = "topology.yaml";
  task.topology = "t";
  task.component = "b";
  task.task = 4;
  task.tasks = {{"a", {1, 2}}, {"b", {3, 4}}, {"c", {5, 6}}};
  task.inputs.push_back({{"a", "default", Fields{"text"}, births}, Fields{"text"}});
  task.outputs.push_back({{"b", "chosen", Fields{"text"}, births}, true, {5, 6}, false, {}});
  task.outputs.push_back({{"b", "default", Fields{"text"}, births}, false, {}, false, {}});
  return task;
}

/// A counter of the task's, in this process's metrics.
std::uint64_t counted(const std::string& name) {
  const TaskDescription task = described();
  return config::process_metrics()
      .counter(name, "",
               {{"topology", task.topology}, {"component", task.component}, {"task", std::to_string(task.task)}})
      .value();
}

/// A histogram of the task's, in this process's metrics.
config::Histogram::Summary timed(const std::string& name) {
  const TaskDescription task = described();
  return config::process_metrics()
      .histogram(name, "",
                 {{"topology", task.topology}, {"component", task.component}, {"task", std::to_string(task.task)}})
      .summary();
}

std::vector<std::byte> bytes_of(const Values& values) {
  std::vector<std::byte> bytes(encoded_size(values.all()));
  encode_values(values.all(), bytes.data());
  return bytes;
}

/// A bolt that runs a function for each tuple.
struct Calls final : Bolt {
  using Call = std::function<void(const Tuple&, OutputCollector&)>;
  explicit Calls(Call given) : call(std::move(given)) {}
  void prepare(const Config&, const TopologyContext& given, OutputCollector& out) override {
    context = &given;
    collector = &out;
  }
  void execute(const Tuple& tuple) override { call(tuple, *collector); }
  Call call;
  const TopologyContext* context = nullptr;
  OutputCollector* collector = nullptr;
};

/// A bolt's host with its Java.
struct BoltTask {
  explicit BoltTask(const Calls::Call& call, const TaskDescription& task = described(),
                    const std::function<void(ComponentSpec&)>& change = {}, std::size_t buffer = 1024)
      : java(buffer) {
    ComponentSpec spec;
    spec.id = "b";
    spec.bolt = [this, call] {
      auto made = std::make_unique<Calls>(call);
      bolt = made.get();
      return made;
    };
    if (change) change(spec);
    host = std::make_unique<BoltHost>(task, Component{spec}, java.buffer(), java, queue);
    java.apply(host->open());
  }
  std::vector<std::string> execute(std::uint32_t slot, const Values& values) {
    const auto bytes = bytes_of(values);
    java.apply(host->execute(slot, 0, 1, {bytes}));
    return java.taken();
  }
  std::int64_t keep(std::uint32_t slot, const Values& values) {
    const auto bytes = bytes_of(values);
    return host->keep(slot, 0, 1, {bytes});
  }
  Java java;
  AnswerQueue queue;
  Calls* bolt = nullptr;
  std::unique_ptr<BoltHost> host;
};

TEST(StormBoltHost, EmitsAnchoredAndAcks) {
  BoltTask task([](const Tuple& tuple, OutputCollector& out) {
    EXPECT_EQ(tuple.source_component(), "a");
    EXPECT_EQ(tuple.source_task(), 1);
    EXPECT_NE(tuple.data()->tree, nullptr);  // a sender to a broker acks it when the broker has confirmed
    out.emit(tuple, Values(tuple.get<std::string>("text") + "!"));
    out.emit(Values("alone"));
    out.emit_direct(6, "chosen", {&tuple, 1}, Values("six"));
    out.ack(tuple);
    out.ack(tuple);
  });
  EXPECT_THAT(task.execute(7, Values("hello")),
              ElementsAre("emit stream 1 @7: hello!", "emit stream 1: alone", "emit stream 0 task 6 @7: six", "ack 7"));
}

TEST(StormBoltHost, TimesEachCallOfExecute) {
  const auto before = timed("iotcloud_task_execute_seconds").count;
  BoltTask task([](const Tuple& tuple, OutputCollector& out) { out.ack(tuple); });
  task.execute(1, Values("x"));
  task.execute(2, Values("x"));
  EXPECT_EQ(timed("iotcloud_task_execute_seconds").count, before + 2);
}

TEST(StormCallTimer, MeasuresEachCallThatIsAloneAndOneInSoManyOfThoseThatFollowClosely) {
  tests::HandClock clock;
  config::Histogram histogram;
  CallTimer timer(clock, histogram);
  const auto call = [&](std::chrono::microseconds takes) { timer.time([&] { clock.advance(takes); }); };
  for (int i = 0; i < 4; ++i) {
    clock.advance(std::chrono::seconds(1));
    call(std::chrono::microseconds(50));
    EXPECT_EQ(histogram.summary().count, static_cast<std::uint64_t>(i + 1));
  }
  // The first of those that come closely shows that they do; the one that stands for the next ones comes with the last.
  call(std::chrono::microseconds(1));
  call(std::chrono::microseconds(1));
  EXPECT_EQ(histogram.summary().count, 6u);
  for (std::uint64_t i = 1; i < CallTimer::most; ++i) call(std::chrono::microseconds(1));
  EXPECT_EQ(histogram.summary().count, 6u);
  call(std::chrono::microseconds(1));
  EXPECT_EQ(histogram.summary().count, 6 + CallTimer::most);
  // After calls that took long each one is measured again, once one of them was.
  for (std::uint64_t i = 0; i < CallTimer::most; ++i) call(std::chrono::milliseconds(1));
  call(std::chrono::milliseconds(1));
  EXPECT_EQ(histogram.summary().count, 7 + 2 * CallTimer::most);
}

TEST(StormBoltHost, KnowsItsPlaceInTheTopology) {
  const BoltTask task([](const Tuple&, OutputCollector&) {});
  EXPECT_EQ(task.bolt->context->task_index, 1);
  EXPECT_EQ(task.bolt->context->task_count, 2);
  EXPECT_THAT(task.bolt->context->inputs, ElementsAre(std::pair<std::string, std::string>("a", "default")));
  EXPECT_EQ(task.bolt->context->input_keys.at(0), Fields{"text"});
}

TEST(StormBoltHost, AnExceptionFailsTheTupleAndIsReported) {
  BoltTask task([](const Tuple& tuple, OutputCollector& out) {
    out.emit(tuple, Values("before"));
    throw std::runtime_error("no");
  });
  EXPECT_THAT(task.execute(1, Values("x")),
              ElementsAre("emit stream 1 @1: before", "error execute() threw: no", "fail 1"));
}

TEST(StormBoltHost, ToTryAgainIsToFailAndNothingIsVoid) {
  BoltTask task([](const Tuple& tuple, OutputCollector& out) {
    EXPECT_FALSE(out.is_void(tuple));
    out.retry(tuple);
  });
  EXPECT_THAT(task.execute(1, Values("x")), ElementsAre("fail 1"));
}

TEST(StormBoltHost, WhatDoesNotFitIsRefusedAsOurRuntimeDoes) {
  std::vector<std::string> texts;
  BoltTask task([&](const Tuple& tuple, OutputCollector& out) {
    const auto refused = [&](const auto& emit) {
      try {
        emit();
      } catch (const std::exception& error) {
        texts.emplace_back(error.what());
      }
    };
    refused([&] { out.emit(Values("a", "b")); });
    refused([&] { out.emit_to("other", {}, Values("a")); });
    refused([&] { out.emit_to("chosen", {}, Values("a")); });
    refused([&] { out.emit_direct(5, "default", {}, Values("a")); });
    refused([&] { out.emit_direct(3, "chosen", {}, Values("a")); });
    refused([&] { out.emit(Values("\xFF")); });
    out.ack(tuple);
  });
  EXPECT_THAT(task.execute(1, Values("x")), ElementsAre("ack 1"));
  EXPECT_THAT(texts,
              ElementsAre(HasSubstr("emits 2 values"), HasSubstr("does not declare"), HasSubstr("is direct"),
                          HasSubstr("not declared direct"), HasSubstr("task 3 does not read"), HasSubstr("not UTF-8")));
}

TEST(StormBoltHost, AnswersOfOtherThreadsWaitUntilTheyAreFetched) {
  BoltTask task([](const Tuple& tuple, OutputCollector& out) {
    std::thread([&out, tuple] {
      out.ack(tuple);
      EXPECT_THROW(out.emit(Values("x")), std::logic_error);
    }).join();
  });
  EXPECT_THAT(task.execute(3, Values("x")), IsEmpty());
  EXPECT_EQ(&task.queue.wait(), task.host.get());
  task.java.apply(task.host->take_answers());
  EXPECT_THAT(task.java.taken(), ElementsAre("ack 3"));
}

/// Waits without giving up the core at once, so that two threads go on at nearly the same time.
template <typename Condition>
void spin_until(Condition&& holds) {
  for (int turns = 0; !holds(); ++turns) {
    if (turns % 1000 == 999) std::this_thread::yield();
  }
}

TEST(StormBoltHost, OfTwoThreadsThatAnswerByOneHandleOnlyTheFirstCounts) {
  std::atomic<const Tuple*> offered = nullptr;
  std::atomic<bool> taken = false;
  int pause = 0;  // turns of a loop: which of the two comes first changes from tuple to tuple
  BoltTask task([&](const Tuple& tuple, OutputCollector& out) {
    taken = false;
    offered = &tuple;
    spin_until([&] { return taken.load(); });
    for (int i = 0, turns = ++pause % 256; i < turns; ++i) taken.load();
    out.ack(tuple);
    spin_until([&] { return offered == nullptr; });
  });
  std::jthread other([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      spin_until([&] { return offered != nullptr || stop.stop_requested(); });
      if (const Tuple* tuple = offered) {
        taken = true;
        task.bolt->collector->ack(*tuple);
        offered = nullptr;
      }
    }
  });
  for (int i = 0; i < 50'000; ++i) {
    std::vector<std::string> answers = task.execute(3, Values("x"));
    task.java.apply(task.host->take_answers());
    for (const std::string& late : task.java.taken()) answers.push_back(late);
    ASSERT_THAT(answers, ElementsAre("ack 3"));
  }
}

TEST(StormBoltHost, ATupleThatIsDroppedIsForgotten) {
  Tuple kept;
  BoltTask task([&](const Tuple& tuple, OutputCollector&) { kept = tuple; });
  EXPECT_THAT(task.execute(3, Values("x")), IsEmpty());
  kept = Tuple();
  task.java.apply(task.host->take_answers());
  EXPECT_THAT(task.java.taken(), ElementsAre("forget 3"));
}

TEST(StormBoltHost, AFullBufferIsAppliedAndALargeCommandGetsALargerOne) {
  BoltTask task(
      [](const Tuple& tuple, OutputCollector& out) {
        out.emit(Values("small"));
        out.emit(Values(std::string(100, 'x')));
        out.ack(tuple);
      },
      described(), {}, 40);
  EXPECT_THAT(task.execute(1, Values("x")),
              ElementsAre("emit stream 1: small", "emit stream 1: " + std::string(100, 'x'), "ack 1"));
}

TEST(StormBoltHost, APayloadThatIsPassedOnDoesNotCrossAgain) {
  std::vector<Tuple> held;
  BoltTask task([&](const Tuple& tuple, OutputCollector& out) {
    const auto& payload = tuple.get<Payload>(0);
    out.emit(Values(payload));
    out.emit(tuple, Values(Payload::copy(payload.bytes())));
    for (const Tuple& other : held) out.emit(other, Values(other.at(0)));
    held.push_back(tuple);
    if (held.size() > 1) out.ack(tuple);
    // It may be another tuple's slot from now on.
    if (held.size() > 1) out.emit(Values(payload));
  });
  const Values large(Payload::copy(std::string(256, 'x')));
  const std::string bytes(256, 'x');
  EXPECT_THAT(task.execute(3, large), ElementsAre("emit stream 1: value 0 of @3", "emit stream 1 @3: " + bytes));
  EXPECT_THAT(task.execute(4, large),
              ElementsAre("emit stream 1: value 0 of @4", "emit stream 1 @4: " + bytes,
                          "emit stream 1 @3: value 0 of @3", "ack 4", "emit stream 1: " + bytes));
  held.clear();
}

TEST(StormBoltHost, LargePayloadsOfCommandsThatWaitAreGivenToJavaInOrder) {
  BoltTask task(
      [](const Tuple& tuple, OutputCollector& out) {
        for (const char letter : {'a', 'b', 'c'}) out.emit(Values(Payload::copy(std::string(least_array, letter))));
        EXPECT_THROW(out.emit(Values(Payload::copy(std::string(least_array, 'd')), "two values")),
                     std::invalid_argument);
        EXPECT_THROW(out.emit(Values("\xFF")), ValueFormatError);
        out.emit(tuple, Values(Payload::copy(std::string(least_array, 'e'))));
        out.ack(tuple);
      },
      described(), {}, 2 * least_array);
  EXPECT_THAT(task.execute(1, Values("x")),
              ElementsAre("emit stream 1: array 16384a", "emit stream 1: array 16384b", "emit stream 1: array 16384c",
                          "emit stream 1 @1: array 16384e", "ack 1"));
  EXPECT_EQ(task.java.most_arrays, 2U);
}

/// As described(), of a task whose readers are bolts of C++.
TaskDescription with_parcels(const std::vector<std::size_t>& told = {}, bool births = false) {
  TaskDescription task = described(births);
  for (TaskDescription::Output& output : task.outputs) {
    output.parcels = true;
    output.told = told;
  }
  return task;
}

Payload large_payload() {
  return Payload::copy(std::string(least_array, 'x'));
}

TEST(StormBoltHost, ALargePayloadForAnotherBoltOfCppStaysInAParcel) {
  const Payload payload = large_payload();
  BoltTask emitter(
      [&](const Tuple& tuple, OutputCollector& out) {
        out.emit(tuple, Values(payload));
        out.emit_direct(6, "chosen", {&tuple, 1}, Values(payload));
        out.emit(Values("small"));
        out.ack(tuple);
      },
      with_parcels());
  EXPECT_THAT(emitter.execute(7, Values("x")),
              ElementsAre("emit stream 1 @7: parcel of 1", "emit stream 0 task 6 @7: parcel of 1",
                          "emit stream 1: small", "ack 7"));
  std::vector<const std::byte*> taken;
  BoltTask reader([&](const Tuple& tuple, OutputCollector& out) {
    taken.push_back(tuple.get<Payload>(0).data());
    out.emit(tuple, Values(tuple.at(0)));  // Java does not have what came in a parcel
    out.ack(tuple);
  });
  for (std::uint32_t slot = 0; slot < 2; ++slot)
    reader.java.apply(reader.host->execute(slot, 0, 4, {.parcel = std::move(emitter.java.parcels.at(slot))}));
  EXPECT_THAT(taken, ElementsAre(payload.data(), payload.data()));
  EXPECT_THAT(reader.java.taken(),
              ElementsAre("emit stream 1 @0: array 16384x", "ack 0", "emit stream 1 @1: array 16384x", "ack 1"));
}

TEST(StormBoltHost, OfAParcelJavaIsToldWhatItGroupsBy) {
  TaskDescription two_fields = with_parcels({1});
  two_fields.outputs.back().fields = Fields{"frame", "key"};
  BoltTask task(
      [](const Tuple& tuple, OutputCollector& out) {
        out.emit(Values(large_payload(), "key"));
        EXPECT_THROW(out.emit(Values(large_payload(), "\xFF")), ValueFormatError);  // its reader may be elsewhere
        out.ack(tuple);
      },
      two_fields);
  task.java.told = 1;
  EXPECT_THAT(task.execute(1, Values("x")), ElementsAre("emit stream 1: parcel of 2, key", "ack 1"));
}

TEST(StormBoltHost, AParcelHasItsTuplesBirth) {
  BoltTask emitter([](const Tuple& tuple, OutputCollector& out) { out.emit(tuple, Values(large_payload())); },
                   with_parcels({}, true));
  const std::int64_t born_ms = config::system_clock().wall_ms() - 60'000;
  EXPECT_THAT(emitter.execute(1, Values("x", born_ms)), ElementsAre("emit stream 1 @1: parcel of 2"));
  EXPECT_NEAR(static_cast<double>(*emitter.java.parcels.at(0)->born_ms), static_cast<double>(born_ms), 1000);
  int executed = 0;
  BoltTask reader([&](const Tuple&, OutputCollector&) { ++executed; }, described(true),
                  [](ComponentSpec& spec) { spec.deadline = std::chrono::seconds(10); });
  reader.java.apply(reader.host->execute(1, 0, 4, {.parcel = std::move(emitter.java.parcels.at(0))}));
  EXPECT_THAT(reader.java.taken(), ElementsAre("ack 1"));
  EXPECT_EQ(executed, 0);
}

TEST(StormBoltHost, ATupleThatWaitsBecauseOfKeepLastMayComeInAParcel) {
  const auto keep = [](ComponentSpec& spec) {
    InputSpec input;
    input.from = "a";
    input.keep_last = 1;
    spec.inputs.push_back(input);
  };
  BoltTask task(
      [](const Tuple& tuple, OutputCollector& out) {
        out.emit(Values(std::to_string(tuple.get<std::int64_t>(1))));
        out.ack(tuple);
      },
      described(), keep);
  for (const std::uint32_t slot : {1, 2}) {
    Values values(large_payload(), slot);
    EXPECT_EQ(task.host->keep(slot, 0, 1, {.parcel = Parcel::pack(values)}), slot == 1 ? -1 : 1);
  }
  task.java.apply(static_cast<std::size_t>(task.host->run_next()));
  EXPECT_THAT(task.java.taken(), ElementsAre("executes 2", "emit stream 1: 2", "ack 2"));
}

TEST(StormBoltHost, LargePayloadsThatFillTheParcelsGoToJava) {
  const Payload payload = Payload::copy(std::string(Parcel::most_bytes / 2, 'x'));
  BoltTask task([&](const Tuple&, OutputCollector& out) { out.emit(Values(payload)); }, with_parcels());
  for (int i = 0; i < 3; ++i) EXPECT_THAT(task.execute(1, Values("x")).front(), "emit stream 1: parcel of 1");
  const std::string array = "emit stream 1: array " + std::to_string(payload.size()) + "x";
  EXPECT_EQ(task.execute(1, Values("x")).front(), array);
  task.java.parcels.clear();
  EXPECT_THAT(task.execute(1, Values("x")).front(), "emit stream 1: parcel of 1");
}

TEST(StormBoltHost, ASmallPayloadCrosses) {
  BoltTask task([](const Tuple& tuple, OutputCollector& out) {
    out.emit(tuple, Values(tuple.at(0)));
    out.ack(tuple);
  });
  EXPECT_THAT(task.execute(1, Values(Payload::copy(std::string("small")))),
              ElementsAre("emit stream 1 @1: small", "ack 1"));
}

TEST(StormBoltHost, TicksComeFromStormOnlyInWholeSeconds) {
  const auto period = [](std::chrono::microseconds tick) {
    const BoltTask task([](const Tuple&, OutputCollector&) {}, described(),
                        [&](ComponentSpec& spec) { spec.tick = tick; });
    return task.host->own_tick_period();
  };
  using std::chrono::milliseconds;
  EXPECT_EQ(period(milliseconds(2000)).count(), 0);
  EXPECT_EQ(period(milliseconds(1500)), milliseconds(1500));
  bool tick = false;
  BoltTask task([&](const Tuple& tuple, OutputCollector& out) {
    tick = tuple.is_tick();
    out.ack(tuple);
  });
  task.java.apply(task.host->tick());
  EXPECT_TRUE(tick);
  EXPECT_THAT(task.java.taken(), IsEmpty());
}

TEST(StormBoltHost, ALateTupleIsNotExecuted) {
  const auto late_stream = [](ComponentSpec& spec) {
    spec.deadline = std::chrono::seconds(10);
    spec.late_stream = "default";
  };
  BoltTask task(
      [](const Tuple& tuple, OutputCollector& out) {
        out.emit(tuple, Values("in time"));
        out.ack(tuple);
      },
      described(true), late_stream);
  const std::int64_t now = config::system_clock().wall_ms();
  const std::uint64_t late = counted("iotcloud_task_late_total");
  EXPECT_THAT(task.execute(1, Values("x", now)), ElementsAre("emit stream 1 @1: in time, born", "ack 1"));
  EXPECT_THAT(task.execute(2, Values("x", now - 60'000)), ElementsAre("emit stream 1 @2: x, born", "ack 2"));
  EXPECT_EQ(counted("iotcloud_task_late_total"), late + 1);
  // Another worker's process may say any birth.
  constexpr auto farthest = std::numeric_limits<std::int64_t>::max();
  constexpr std::int64_t four_centuries_ms = std::int64_t{400} * 365 * 24 * 3600 * 1000;
  EXPECT_THAT(task.execute(3, Values("x", farthest)), ElementsAre("emit stream 1 @3: in time, born", "ack 3"));
  EXPECT_THAT(task.execute(4, Values("x", -farthest)), ElementsAre("emit stream 1 @4: x, born", "ack 4"));
  EXPECT_THAT(task.execute(5, Values("x", now - four_centuries_ms)), ElementsAre("emit stream 1 @5: x, born", "ack 5"));
  EXPECT_EQ(counted("iotcloud_task_late_total"), late + 3);
}

TEST(StormBoltHost, OfAnInputWithKeepLastOnlyTheNewestTuplesOfAKeyAreExecuted) {
  const auto keep = [](ComponentSpec& spec) {
    InputSpec input;
    input.from = "a";
    input.keep_last = 1;
    input.keep_key = Fields{"text"};
    spec.inputs.push_back(input);
  };
  BoltTask task(
      [](const Tuple& tuple, OutputCollector& out) {
        if (tuple.is_tick()) return out.emit(Values("tick"));
        out.emit(tuple, Values(tuple.get<std::string>("text")));
        out.ack(tuple);
      },
      described(), keep);
  ASSERT_TRUE(task.host->keeps());
  const std::uint64_t before = counted("iotcloud_task_superseded_total");
  std::vector<std::int64_t> replaced;
  for (const auto& [slot, text] : {std::pair(1U, "x"), {2U, "y"}, {3U, "x"}})
    replaced.push_back(task.keep(slot, Values(text)));
  EXPECT_THAT(replaced, ElementsAre(-1, -1, 1));
  EXPECT_EQ(counted("iotcloud_task_superseded_total"), before + 1);
  task.host->request_tick();
  const auto next = [&] {
    task.java.apply(static_cast<std::size_t>(task.host->run_next()));
    return task.java.taken();
  };
  // The newest x has the place of the one that it replaced.
  EXPECT_THAT(next(), ElementsAre("emit stream 1: tick", "executes 3", "emit stream 1 @3: x", "ack 3"));
  EXPECT_THAT(next(), ElementsAre("executes 2", "emit stream 1 @2: y", "ack 2"));
  task.host->end_keeping();
  EXPECT_EQ(task.host->run_next(), -1);
}

TEST(StormWorkerPages, AWorkerTakesTheNextPortWhenAnotherHasIt) {
  const WorkerPages first({"127.0.0.1:0", {}, ""});
  const WorkerPages second({first.address(), {}, ""});
  const auto port_of = [](const WorkerPages& pages) {
    return std::stoi(pages.address().substr(pages.address().rfind(':') + 1));
  };
  EXPECT_GT(port_of(second), port_of(first));
  EXPECT_LT(port_of(second), port_of(first) + WorkerPages::ports_of_a_machine);
  config::process_metrics().counter("test_pages_total", "").add();
  EXPECT_THAT(rpc::http_get(second.address(), "/metrics"), HasSubstr("\ntest_pages_total 1\n"));
  EXPECT_EQ(WorkerPages(rpc::PageSettings{}).address(), "");
}

/// Whether a thread of this process waits for something.
bool sleeps(pid_t thread) {
  std::ifstream file("/proc/self/task/" + std::to_string(thread) + "/stat");
  std::string stat((std::istreambuf_iterator<char>(file)), {});
  const auto name_end = stat.rfind(')');
  return name_end != std::string::npos && stat.substr(name_end, 3) == ") S";
}

TEST(StormKeptTuples, AnInputThatKeepsAllWaitsForRoom) {
  KeptTuples kept({});
  Tuple tuple;
  BoltTask source([&](const Tuple& given, OutputCollector&) { tuple = given; });
  source.execute(1, Values("x"));
  for (std::size_t i = 0; i < KeptTuples::capacity; ++i) EXPECT_FALSE(kept.put(tuple));
  std::atomic<bool> put{false};
  std::atomic<pid_t> putter{0};
  std::thread other([&] {
    putter = gettid();
    kept.put(tuple);
    put = true;
  });
  // Until it sleeps, or did not wait.
  while (!put && (putter == 0 || !sleeps(putter))) std::this_thread::yield();
  EXPECT_FALSE(put);
  EXPECT_TRUE(kept.next().tuple);
  other.join();
  EXPECT_TRUE(put);
  kept.end();
  EXPECT_TRUE(kept.next().end);
  tuple = {};  // before its host
}

/// A spout that emits once for each call, and fails at the third.
struct Three final : Spout {
  void declare_output_fields(OutputFieldsDeclarer&) const override {}
  void open(const Config&, const TopologyContext& context, SpoutOutputCollector& out) override {
    waker = context.waker;
    collector = &out;
  }
  bool next_tuple() override {
    if (++calls == 1) collector->emit(Values("tracked"), 5);
    if (calls == 2) collector->emit(Values("untracked"));
    if (calls == 3) throw std::runtime_error("no more");
    return true;
  }
  void ack(MessageId id) override { collector->emit(Values("acked"), id + 1); }
  int calls = 0;
  SpoutWaker waker;
  SpoutOutputCollector* collector = nullptr;
};

TEST(StormSpoutHost, EmitsAndIsWoken) {
  Java java;
  Three* spout = nullptr;
  ComponentSpec spec;
  spec.spout = [&] {
    auto made = std::make_unique<Three>();
    spout = made.get();
    return made;
  };
  SpoutHost host(described(), Component{spec}, java.buffer(), java);
  java.apply(host.open());
  for (int i = 0; i < 3; ++i) java.apply(host.next_tuple());
  const auto before = timed("iotcloud_spout_complete_seconds").count;
  java.apply(host.ack(5, std::chrono::milliseconds(3)));
  const auto complete = timed("iotcloud_spout_complete_seconds");
  EXPECT_EQ(complete.count, before + 1);
  EXPECT_GE(complete.max_ns, 2.9e6);
  EXPECT_THAT(java.taken(), ElementsAre("emit stream 1 id 5: tracked", "emit stream 1: untracked",
                                        "error next_tuple() threw: no more", "emit stream 1 id 6: acked"));
  spout->waker.wake();
  EXPECT_EQ(java.wakes, 1);
}

/// An emitting task whose stream has a grouping of the library of components.cc, which Flux or Java named.
TaskDescription emitter_for(const std::string& grouping) {
  const std::filesystem::path library = COMPONENTS_LIBRARY;
  TaskDescription task = described();
  task.file = "";
  task.folder = library.parent_path();
  task.library = library.filename();
  task.class_name = grouping;
  task.outputs = {{{"b", "default", Fields{"key", "n"}, false}, false, {}, false, {}}};
  return task;
}

TEST(StormGroupingHost, ChoosesByAClassOfALibrary) {
  GroupingHost host(emitter_for("test.ByNumber"), "", 0, {5, 6, 7});
  std::int32_t chosen[3] = {};
  EXPECT_EQ(host.choose(bytes_of(Values("k", 4)), chosen), 1);
  EXPECT_EQ(chosen[0], 6);
}

TEST(StormGroupingHost, LetsThroughWhatTheGroupingThrows) {
  GroupingHost host(emitter_for("test.Picky"), "", 0, {5, 6, 7});
  std::int32_t chosen[3] = {};
  const auto bytes = bytes_of(Values("k", 100));
  EXPECT_THAT([&] { host.choose(bytes, chosen); },
              testing::ThrowsMessage<std::runtime_error>("nobody takes number 100"));
  EXPECT_EQ(host.choose(bytes, chosen), 1);
  EXPECT_EQ(chosen[0], 6);
}

TEST(StormGroupingHost, SaysThatALibraryHasNoSuchGrouping) {
  EXPECT_THAT([] { GroupingHost(emitter_for("test.ByNumbers"), "", 0, {5}); },
              testing::ThrowsMessage<config::Error>(HasSubstr("registers no grouping \"test.ByNumbers\"")));
}

TEST(StormTaskDescription, IsReadFromJson) {
  const auto task = TaskDescription::parse(R"({"folder": "/f", "file": "", "library": "l.so", "class": "C",
    "conf": {"a": "1"}, "topology": "t", "component": "b", "task": 4, "tasks": {"a": [1], "b": [3, 4]}, "here": [4],
    "inputs": [{"component": "a", "stream": "s", "fields": ["x", "__born"], "key": ["x"]}],
    "outputs": [{"component": "b", "stream": "default", "fields": ["y"], "direct": true, "targets": [1],
      "parcels": true, "told": [0]}]})");
  EXPECT_EQ(task.class_name, "C");
  EXPECT_TRUE(task.inputs.at(0).births);
  EXPECT_EQ(task.inputs.at(0).fields, Fields{"x"});
  EXPECT_FALSE(task.outputs.at(0).births);
  EXPECT_TRUE(task.outputs.at(0).parcels);
  EXPECT_THAT(task.outputs.at(0).told, ElementsAre(0));
  EXPECT_EQ(task.context().task_index, 1);
  EXPECT_THROW(static_cast<void>(TaskDescription::parse("{}")), config::Error);
}

}  // namespace
}  // namespace iotcloud::topology::storm
