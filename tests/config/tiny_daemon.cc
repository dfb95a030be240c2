#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/rpc/http/metrics_endpoint.h>

namespace {

using iotcloud::config::DaemonService;
using iotcloud::config::YamlSection;
using iotcloud::rpc::MetricsEndpoint;

/// A daemon whose file says how it behaves when it is stopped.
class TinyService : public DaemonService {
 public:
  explicit TinyService(const std::string& file) {
    auto top = YamlSection::load_file(file);
    start_ = top.choice_or("start", "at once", {"at once", "wait"});
    stop_ = top.choice_or("stop", "at once", {"at once", "hang"});
    metrics_ = top.optional_string("metrics");
    trouble_ = top.string_or("trouble", "");
    unreadable_ = top.string_or("unreadable", "");
    iotcloud::config::read_log_settings(top);
    top.finish();
  }
  void start(const std::stop_token& stop) override {
    if (start_ == "wait") {
      iotcloud::config::log_line(iotcloud::config::LogLevel::info, "tiny", "waits");
      while (!stop.stop_requested()) std::this_thread::yield();
    }
    iotcloud::config::process_metrics().counter("tiny_total", "Tiny things", {{"kind", "a"}}).add(3);
    iotcloud::config::process_metrics().histogram("tiny_seconds", "Tiny times").record_ns(2'000'000);
    if (metrics_)
      endpoint_.emplace(iotcloud::rpc::PageSettings{*metrics_, {}, ""}, iotcloud::config::process_metrics(),
                        [this] { return trouble(); });
  }
  void stop(std::chrono::milliseconds limit) override {
    iotcloud::config::log_line(iotcloud::config::LogLevel::info, "tiny",
                               "has " + std::to_string(limit.count()) + " ms to stop");
    while (stop_ == "hang") std::this_thread::yield();
  }
  void reload() override {
    if (!unreadable_.empty()) throw iotcloud::config::Error(unreadable_);
    iotcloud::config::log_line(iotcloud::config::LogLevel::info, "tiny", "read again what it has");
  }
  std::string trouble() const override { return trouble_; }

 private:
  std::string start_;
  std::string stop_;
  std::string trouble_;
  std::string unreadable_;  ///< the error of reload(); empty: none
  std::optional<std::string> metrics_;
  std::optional<MetricsEndpoint> endpoint_;
};

}  // namespace

int main(int argc, char** argv) {
  return iotcloud::config::run_daemon(
      argc, argv,
      {.name = "tiny-daemon",
       .description = "Does nothing until it is stopped.",
       .build = [](const std::string& file) { return std::make_unique<TinyService>(file); },
       .stop_limit = std::chrono::seconds(3)});
}
