#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include <unistd.h>

#include <iotcloud/drivers/plugin.h>

namespace iotcloud::gateway {

using namespace std::chrono_literals;

/// A driver that falls ill, or stays healthy, as the deployment's properties say.
///   illness: segfault, hang, leak, spin or exit; none: healthy
///   trigger: it falls ill when this file appears (and removes it); none: as soon as it is opened
///   diary: a healthy one appends a line "PROCESS NUMBER" to this file every 10 ms
class SickDriver final : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override { return {}; }

  void open(drivers::DriverContext& context) override {
    context_ = &context;
    illness_ = value("illness");
    if (const std::string diary = value("diary"); !diary.empty()) {
      diary_.open(diary, std::ios::app);
      context.every(10ms, [this] { diary_ << getpid() << ' ' << ++number_ << std::endl; });
    }
    const std::string trigger = value("trigger");
    if (trigger.empty()) {
      context.post([this] { fall_ill(); });
    } else {
      context.every(5ms, [this, trigger] {
        if (std::filesystem::remove(trigger)) fall_ill();
      });
    }
  }

 private:
  std::string value(const std::string& name) const {
    const auto& properties = context_->properties();
    const auto found = properties.find(name);
    return found == properties.end() ? "" : found->second;
  }

  void fall_ill() {
    if (illness_ == "segfault") {
      std::signal(SIGSEGV, SIG_DFL);  // a sanitizer's handler would write its report
      std::raise(SIGSEGV);
    } else if (illness_ == "hang") {
      for (;;) ::pause();
    } else if (illness_ == "leak") {
      leak();
    } else if (illness_ == "spin") {
      spin();
    } else if (illness_ == "exit") {
      _exit(3);
    }
  }

  /// The thread sleeps between two pieces, else it would count as spinning: so the next one is timed when this one is
  /// there. every() is late at once on a busy machine, and then the thread does not sleep. Nor does it when it waits
  /// for a processor most of the time: so a byte is written to each page, which makes it the process's, and no more.
  void leak() {
    constexpr std::size_t piece = std::size_t{2} << 20, page = 4096;
    leaked_.push_back(std::make_unique_for_overwrite<char[]>(piece));
    for (std::size_t at = 0; at < piece; at += page) leaked_.back()[at] = 1;
    context_->after(20ms, [this] { leak(); });
  }

  /// The event thread comes round all the time, and never sleeps.
  void spin() {
    context_->post([this] { spin(); });
  }

  drivers::DriverContext* context_ = nullptr;
  std::string illness_;
  std::ofstream diary_;
  int number_ = 0;
  std::vector<std::unique_ptr<char[]>> leaked_;
};

}  // namespace iotcloud::gateway

IOTCLOUD_DRIVER(iotcloud::gateway::SickDriver, "sick", "1.0")
