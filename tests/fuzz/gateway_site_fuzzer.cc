// What anybody may send to a gateway's Thrift service: a gateway on an embedded registry that has no plugin, and takes
// those that are sent. The ids of uploads are 0, 1, ... in each input, so that an input can come to the end of one.
#include <algorithm>
#include <filesystem>
#include <optional>

#include <unistd.h>

#include "iotcloud/config/log.h"
#include "iotcloud/discovery/registry.h"
#include "iotcloud/gateway/fleet/in_process_launcher.h"
#include "iotcloud/gateway/gateway.h"
#include "iotcloud/gateway/site_handler.h"
#include "iotcloud/security/sha256.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/tests/fuzz/thrift_frames.h"
#include "iotcloud/tests/fuzz/whole_uploads.h"

using namespace iotcloud;

namespace {

class GatewayWithSite {
 public:
  GatewayWithSite() {
    gateway::InProcessLauncher::Options hosts;
    hosts.plugin_dir = "/nonexistent";
    gateway::GatewayOptions options;
    options.id = discovery::GatewayId("lab1");
    options.brokers.push_back({"local", "embedded", {}});
    options.brokers.back().options.urls = {"embedded://fuzz-site"};
    options.registry = registry_.get();
    processes::PluginStore::Options plugins;
    plugins.folder = folder_;
    plugins.most_bytes = 1 << 16;
    plugins.clock = &clock_;
    plugins.new_upload_id = [this] { return std::to_string(uploads_++); };
    longest_kept_ = std::max(plugins.idle_limit, plugins.unnamed_limit);
    options.plugins = std::make_shared<processes::PluginStore>(plugins);
    options.launcher = std::make_shared<gateway::InProcessLauncher>(hosts);
    gateway_.emplace(options);
    gateway_->start();
    access_.rules = gateway::SiteService::rules();
    site_.outcome_limit = std::chrono::milliseconds(100);
    site_.log_folder = "/nonexistent";
    service_ = [this](const std::shared_ptr<rpc::ThriftPeer>& peer) {
      auto session = std::make_shared<rpc::CallerSession>(access_, peer);
      return rpc::guarded(
          std::make_shared<gateway::wire::TSensorSiteServiceProcessor>(
              std::make_shared<gateway::SiteHandler>(site_, *gateway_, *registry_, discovery::Paths(), session)),
          session);
    };
  }
  ~GatewayWithSite() {
    service_ = nullptr;
    gateway_.reset();
    std::filesystem::remove_all(folder_);
  }

  const rpc::ThriftService& service() const { return service_; }
  bool is_full() { return gateway_->instances().size() > 1'000; }
  /// Nothing of an input's uploads is there for the next one. \return how many plugins came whole.
  int forget_plugins() {
    int whole = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder_))
      whole += security::is_sha256(entry.path().filename().string()) ? 1 : 0;
    uploads_ = 0;
    clock_.move(longest_kept_);
    gateway_->plugins()->clean({});
    return whole;
  }

 private:
  static std::unique_ptr<discovery::Registry> fresh_registry() {
    static int number = 0;
    discovery::RegistryOptions options;
    options.url = "embedded://fuzz-site-" + std::to_string(number++);
    return discovery::make_registry(options);
  }

  const std::filesystem::path folder_ =
      std::filesystem::temp_directory_path() / ("iotcloud-fuzz-site-" + std::to_string(getpid()));
  fuzz::InputClock clock_;
  std::chrono::milliseconds longest_kept_{0};
  int uploads_ = 0;
  std::unique_ptr<discovery::Registry> registry_ = fresh_registry();
  std::optional<gateway::Gateway> gateway_;
  rpc::AccessOptions access_;
  gateway::SiteService::Options site_;
  rpc::ThriftService service_;
};

}  // namespace

IOTCLOUD_FUZZ_TARGET(gateway_site, 2'000) {
  config::set_log_level(config::LogLevel::off);
  static fuzz::Tally tally;
  static auto site = std::make_unique<GatewayWithSite>();
  const gateway::SiteService::Options options;
  rpc::ThriftServerOptions limits;
  limits.max_message_bytes = options.max_message_bytes;
  limits.max_items = options.max_items;
  fuzz::serve(site->service(), data, size, limits);
  tally.whole += site->forget_plugins();
  if (site->is_full()) {
    site.reset();
    site = std::make_unique<GatewayWithSite>();
  }
}
