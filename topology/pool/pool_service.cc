#include <algorithm>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <utility>

#include <fmt/format.h>

#include "iotcloud/topology/pool/TPoolService.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/processes/log_reader.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/pool_service.h>
#include <iotcloud/topology/pool/worker_processes.h>

namespace iotcloud::topology {

using rpc::RefusalForm;
using security::Role;

namespace {

constexpr std::int32_t most_of_log = 256 * 1024;  ///< bytes of a log in one answer
constexpr std::int64_t piece = std::int64_t{512} * 1024;

/// Implements the service's methods for one connection.
class PoolHandler final : public wire::TPoolServiceIf {
 public:
  PoolHandler(const PoolService::Options& options, std::shared_ptr<rpc::CallerSession> session)
      : options_(options), session_(std::move(session)) {}

  void authenticate(discovery::wire::TResponse& answer, const std::string& token) override {
    const std::string problem = session_->authenticate(token);
    answer.__set_state(problem.empty() ? discovery::wire::TResponseState::SUCCESS
                                       : discovery::wire::TResponseState::FAILURE);
    answer.__set_statusMessage(problem);
  }

  void ping(wire::TPoolPing& answer) override {
    answer.__set_pool(options_.pool);
    answer.__set_timeMs(config::system_clock().wall_ms());
  }

  void readLog(wire::TWorkerLogPart& answer, const std::string& topology, std::int32_t place,
               const std::string& position, std::int32_t most_bytes) override {
    answering([&] {
      if (!processes::is_plain_file_name(topology))
        throw config::Error(fmt::format("\"{}\" is no topology's name", topology));
      const auto log = WorkerProcesses::log_of(options_.state_folder, {discovery::TopologyName(topology), place});
      const auto part =
          processes::read_log(log, position, static_cast<std::size_t>(std::clamp(most_bytes, 1, most_of_log)));
      answer.__set_text(part.text);
      answer.__set_position(part.position);
    });
  }

  void offerLibrary(std::string& upload, const wire::TLibraryOffer& offer) override {
    taking(fmt::format("{}, SHA-256 {}", offer.plugin, offer.sha256), [&] {
      upload = options_.libraries->offer({offer.plugin, offer.sha256, offer.size, offer.signature});
      return upload.empty() ? "it is there already" : "taken as " + upload;
    });
  }
  void sendLibrary(const std::string& upload, std::int64_t offset, const std::string& bytes) override {
    answering([&] { options_.libraries->add(upload, offset, bytes); });
  }
  void finishLibrary(const std::string& upload) override {
    taking(upload, [&] {
      options_.libraries->finish(upload);
      options_.on_library();
      return std::string("done");
    });
  }

  void describeLibrary(wire::TKeptLibrary& answer, const std::string& sha256) override {
    answering([&] {
      answer.__set_size(static_cast<std::int64_t>(std::filesystem::file_size(path_of(sha256))));
      const std::string signature = options_.libraries->signature_path_of(sha256);
      answer.__set_signature(std::filesystem::exists(signature) ? processes::read_file(signature, 0) : "");
    });
  }
  void readLibrary(std::string& answer, const std::string& sha256, std::int64_t offset) override {
    answering([&] {
      const auto path = path_of(sha256);
      const auto size = static_cast<std::int64_t>(std::filesystem::file_size(path));
      if (offset < 0 || offset > size)
        throw config::Error(fmt::format("the library has {} bytes, none at {}", size, offset));
      std::ifstream file(path, std::ios::binary);
      file.seekg(offset);
      answer.resize(static_cast<std::size_t>(std::min(piece, size - offset)));
      if (!file.read(answer.data(), static_cast<std::streamsize>(answer.size())))
        throw config::Error(fmt::format("{} cannot be read", path));
    });
  }

 private:
  std::string path_of(const std::string& sha256) const {
    const auto path = options_.libraries->path_of(sha256);
    if (!path) throw config::Error(fmt::format("this pool has no library with the SHA-256 {}", sha256));
    return *path;
  }

  template <typename Body>
  void answering(Body&& body) {
    try {
      body();
    } catch (const std::runtime_error& e) {
      wire::TPoolError error;
      error.__set_reason(e.what());
      throw error;
    }
  }

  /// Runs a method that takes a library, and tells the audit log before and after it.
  template <typename Body>
  void taking(std::string what, Body&& body) {
    answering([&] {
      session_->begins(std::move(what));
      session_->note("refused");
      try {
        session_->note(body());
      } catch (const config::Error& e) {
        pool_logger.warn("a library was not taken: {}", e.what());
        config::process_metrics()
            .counter("iotcloud_pool_libraries_refused_total",
                     "Component libraries that somebody wanted to send and that were not taken")
            .add();
        throw;
      }
    });
  }

  const PoolService::Options& options_;
  const std::shared_ptr<rpc::CallerSession> session_;
};

}  // namespace

const rpc::MethodRules& PoolService::rules() {
  static const rpc::MethodRules rules{
      {"authenticate", {Role::anyone, RefusalForm::response}},
      {"ping", {Role::viewer}},
      {"readLog", {Role::viewer, RefusalForm::error}},
      {"offerLibrary", {Role::admin, RefusalForm::error, true, true}},
      {"sendLibrary", {Role::admin, RefusalForm::error, false, true}},
      {"finishLibrary", {Role::admin, RefusalForm::error, true, true}},
      {"describeLibrary", {Role::admin, RefusalForm::error, false, true}},
      {"readLibrary", {Role::admin, RefusalForm::error, false, true}},
  };
  return rules;
}

std::shared_ptr<apache::thrift::TProcessor> PoolService::processor(const Options& options,
                                                                   std::shared_ptr<rpc::CallerSession> session) {
  return std::make_shared<wire::TPoolServiceProcessor>(std::make_shared<PoolHandler>(options, std::move(session)));
}

namespace {

rpc::GuardedService::Options guarding(const PoolService::Options& options) {
  rpc::GuardedService::Options guarding;
  guarding.rules = PoolService::rules();
  guarding.listen = options.listen;
  if (!options.audit.file.empty()) guarding.audit = std::make_shared<security::AuditLog>(options.audit);
  guarding.limits.name = "pool";
  return guarding;
}

}  // namespace

PoolService::PoolService(const Options& options)
    : service_(guarding(options), [options](auto session) { return processor(options, std::move(session)); }) {}

}  // namespace iotcloud::topology
