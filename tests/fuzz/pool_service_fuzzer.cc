// What anybody may send to the Thrift service of a pool of workers that keeps what was sent, and has the log of one
// worker. The ids of uploads are 0, 1, ... in each input, so that an input can come to the end of one.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <memory>

#include <unistd.h>

#include "iotcloud/config/log.h"
#include "iotcloud/security/sha256.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/tests/fuzz/thrift_frames.h"
#include "iotcloud/tests/fuzz/whole_uploads.h"
#include "iotcloud/topology/pool/pool_service.h"
#include "iotcloud/topology/pool/worker_processes.h"

using namespace iotcloud;

namespace {

class PoolWithService {
 public:
  PoolWithService() {
    processes::PluginStore::Options libraries;
    libraries.folder = folder_ / "libraries";
    libraries.most_bytes = 1 << 16;
    libraries.clock = &clock_;
    libraries.new_upload_id = [this] { return std::to_string(uploads_++); };
    longest_kept_ = std::max(libraries.idle_limit, libraries.unnamed_limit);
    options_.pool = discovery::PoolId("pool1");
    options_.state_folder = folder_;
    options_.libraries = std::make_shared<processes::PluginStore>(libraries);
    options_.on_library = [] {};
    const std::filesystem::path log = topology::WorkerProcesses::log_of(folder_, {discovery::TopologyName("echo"), 0});
    std::filesystem::create_directories(log.parent_path());
    std::ofstream(log) << "a line\nanother line\n";
    access_.rules = topology::PoolService::rules();
    service_ = [this](const std::shared_ptr<rpc::ThriftPeer>& peer) {
      auto session = std::make_shared<rpc::CallerSession>(access_, peer);
      return rpc::guarded(topology::PoolService::processor(options_, session), session);
    };
  }
  ~PoolWithService() { std::filesystem::remove_all(folder_); }
  PoolWithService(const PoolWithService&) = delete;
  PoolWithService& operator=(const PoolWithService&) = delete;

  const rpc::ThriftService& service() const { return service_; }
  /// Nothing of an input's uploads is there for the next one. \return how many libraries came whole.
  int forget_libraries() {
    int whole = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder_ / "libraries"))
      whole += security::is_sha256(entry.path().filename().string()) ? 1 : 0;
    uploads_ = 0;
    clock_.move(longest_kept_);
    options_.libraries->clean({});
    return whole;
  }

 private:
  const std::filesystem::path folder_ =
      std::filesystem::temp_directory_path() / ("iotcloud-fuzz-pool-" + std::to_string(getpid()));
  fuzz::InputClock clock_;
  std::chrono::milliseconds longest_kept_{0};
  int uploads_ = 0;
  topology::PoolService::Options options_;
  rpc::AccessOptions access_;
  rpc::ThriftService service_;
};

}  // namespace

IOTCLOUD_FUZZ_TARGET(pool_service, 2'000) {
  config::set_log_level(config::LogLevel::off);
  static fuzz::Tally tally;
  static PoolWithService pool;
  fuzz::serve(pool.service(), data, size, rpc::ThriftServerOptions());
  tally.whole += pool.forget_libraries();
}
