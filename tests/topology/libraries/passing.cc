// Passes messages on; for tests of topologies that are sent to pools (tests/system/pool_test.py). With the conf
// `fail_at: prepare` it cannot start; with `stand_still: FILE` a call that finds the file removes it and does not
// return. With `victim: PROCESS` it tries to signal this process and to read its memory and environment, and with
// `secrets: FILE FILE` to read these files; what comes of each is a line on stdout.
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <sstream>
#include <stdexcept>
#include <string>

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

#include <iotcloud/topology/plugin.h>

namespace {
using namespace iotcloud::topology;

void tell(const std::string& what, bool done) {
  std::printf("tried %s: %s\n", what.c_str(), done ? "ok" : strerrorname_np(errno));
  std::fflush(stdout);
}

void try_to_read(const std::string& file) {
  const int opened = open(file.c_str(), O_RDONLY | O_CLOEXEC);
  tell(file.substr(file.rfind('/') + 1), opened >= 0);
  close(opened);
}

struct Pass : BasicBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"data", "driverID", "time"});
  }
  void prepare(const Config& config, const TopologyContext&) override {
    const auto found = config.find("fail_at");
    if (found != config.end() && found->second == "prepare")
      throw std::runtime_error("as the conf says, this bolt cannot start");
    const auto file = config.find("stand_still");
    if (file != config.end()) stand_still_ = file->second;
    const auto victim = config.find("victim");
    if (victim != config.end()) {
      tell("signal", kill(std::stoi(victim->second), 0) == 0);
      for (const char* name : {"mem", "environ"}) try_to_read("/proc/" + victim->second + "/" + name);
    }
    const auto secrets = config.find("secrets");
    std::istringstream files(secrets == config.end() ? "" : secrets->second);
    for (std::string secret; files >> secret;) try_to_read(secret);
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    if (!stand_still_.empty() && std::remove(stand_still_.c_str()) == 0) {
      while (true) pause();
    }
    collector.emit(Values(tuple.at("data"), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  std::string stand_still_;
};
}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Pass>("passing.Pass");
}
