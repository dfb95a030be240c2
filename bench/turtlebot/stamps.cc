#include <cstdint>
#include <cstdio>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <dlfcn.h>

#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/plugin.h>

/// The follower's components with a record of when they worked: loads the library that IOTCLOUD_FOLLOWER names and
/// wraps its bolts. Their `conf` takes one more key, `stamps`: the folder in which each task leaves a file
/// COMPONENT-TASK.csv when the topology ends. All times are the machine's monotonic clock, in nanoseconds.
namespace iotcloud::bench {

namespace {

using topology::Bolt;
using topology::ComponentRegistry;
using topology::Config;
using topology::OutputCollector;
using topology::OutputFieldsDeclarer;
using topology::TopologyContext;
using topology::Tuple;

constexpr std::size_t room = 100'000;  // reserved before the run: no allocation during the run

class StampedBolt final : public Bolt {
 public:
  explicit StampedBolt(std::unique_ptr<Bolt> bolt) : bolt_(std::move(bolt)) {}

  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { bolt_->declare_output_fields(declarer); }

  void prepare(const Config& config, const TopologyContext& context, OutputCollector& collector) override {
    Config own = config;
    const auto folder = own.extract("stamps");
    if (!folder) throw std::invalid_argument("stamps: it is missing; name the folder for the time stamps");
    file_ = folder.mapped() + "/" + context.component + "-" + std::to_string(context.task) + ".csv";
    stamps_.reserve(room);
    bolt_->prepare(own, context, collector);
  }

  void execute(const Tuple& tuple) override {
    const std::int64_t begin_ns = now_ns();
    bolt_->execute(tuple);
    if (tuple.is_tick() || stamps_.size() == room) return;
    stamps_.push_back({tuple.get<std::int64_t>("time"), tuple.data()->born_ns, begin_ns, now_ns()});
  }

  void cleanup() override {
    bolt_->cleanup();
    if (stamps_.empty()) return;
    const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(file_.c_str(), "w"), &std::fclose);
    if (!file) throw std::runtime_error("cannot write \"" + file_ + "\"");
    std::fputs("time_ms,born_ns,begin_ns,end_ns\n", file.get());
    for (const Stamp& stamp : stamps_) {
      std::fprintf(file.get(), "%lld,%lld,%lld,%lld\n", static_cast<long long>(stamp.time_ms),
                   static_cast<long long>(stamp.born_ns), static_cast<long long>(stamp.begin_ns),
                   static_cast<long long>(stamp.end_ns));
    }
    if (std::fflush(file.get()) != 0) throw std::runtime_error("cannot write all of \"" + file_ + "\"");
  }

 private:
  struct Stamp {
    std::int64_t time_ms;   ///< which frame
    std::int64_t born_ns;   ///< when the spout emitted it
    std::int64_t begin_ns;  ///< start of execute()
    std::int64_t end_ns;
  };
  const std::unique_ptr<Bolt> bolt_;
  std::string file_;
  std::vector<Stamp> stamps_;
};

/// Never unloaded: its objects live until the process ends.
void fill(ComponentRegistry& registry, const char* library) {
  void* const handle = dlopen(library, RTLD_NOW | RTLD_LOCAL);
  if (handle == nullptr) throw std::runtime_error(dlerror());
  using Describe = const topology::LibraryDescriptor*();
  const auto describe = reinterpret_cast<Describe*>(dlsym(handle, topology::library_symbol));
  if (describe == nullptr) throw std::runtime_error(dlerror());
  describe()->fill(registry);
}

}  // namespace

}  // namespace iotcloud::bench

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  using namespace iotcloud;
  bench::fill(registry, IOTCLOUD_FOLLOWER);
  for (const char* name : {"turtlebot.Decoder", "turtlebot.Follow"}) {
    const topology::BoltFactory inner = *registry.bolt(name);
    registry.add_bolt(name, [inner] { return std::make_unique<bench::StampedBolt>(inner()); });
  }
}
